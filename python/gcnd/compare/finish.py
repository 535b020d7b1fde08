"""The end of a comparison: means, tables for other programs, and the page."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gcnd
from gcnd.compare.methods import classical_labels
from gcnd.compare.output import write_csv, write_json
from gcnd.compare.report import Pictured, draw_pictures, write_report
from gcnd.compare.rows import Row
from gcnd.compare.summary import Line, summarise, with_best

if TYPE_CHECKING:
    from gcnd.compare.cases import Case
    from gcnd.compare.methods import Method

__all__ = ["finish", "machine"]


def finish(
    out: Path,
    options: Mapping[str, Any],
    cases: Sequence[Case],
    methods: Sequence[Method],
    rows: Sequence[Row],
    *,
    skipped: Sequence[str] = (),
    pictures: Pictured = "one",
    progress: Callable[[float, str], object] | None = None,
) -> list[Line]:
    """Writes ``results.csv``, ``results.json`` and ``report.html``.

    Args:
        out: Folder of the comparison.
        options: Of the run, ``dataset`` and ``threads`` among them.
        cases: What was denoised.
        methods: What was run.
        rows: Of `gcnd.compare.run.compare`.
        skipped: Lines about libraries that are missing.
        pictures: Which cases are drawn.
        progress: Called with (fraction done, what is drawn).

    Returns:
        The means.

    Raises:
        GcndError: matplotlib or jinja2 is not installed.
    """
    about = {**options, **machine()}
    whole = with_best(rows, classical_labels(methods))
    lines = summarise(whole)
    write_csv(out / "results.csv", whole)
    write_json(out / "results.json", {**about, "skipped": list(skipped)}, whole, lines)
    drawn = draw_pictures(cases, rows, out, pictures, progress)
    write_report(out / "report.html", about, methods, whole, lines, drawn, skipped)
    return lines


def machine() -> dict[str, Any]:
    """Returns version, time, processor and system that figures depend on."""
    name = platform.processor() or platform.machine()
    if os.path.exists("/proc/cpuinfo"):
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            names = [line.split(":", 1)[1].strip() for line in file if line.startswith("model name")]
        name = names[0] if names else name
    return {
        "gcnd": gcnd.__version__,
        "time": datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC"),
        "processor": name,
        "system": platform.system(),
        "python": platform.python_version(),
    }

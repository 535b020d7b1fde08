"""One self-contained HTML page about a comparison: tables, charts, failures and pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from gcnd.compare.charts import bar_chart, time_chart
from gcnd.compare.pictures import CasePictures, draw_case
from gcnd.compare.rows import INPUT, Row
from gcnd.compare.run import load_result
from gcnd.compare.summary import ALL, Line
from gcnd.errors import GcndError
from gcnd.formats.atomic import write_atomic
from gcnd.page import html_page

if TYPE_CHECKING:
    from gcnd.compare.cases import Case
    from gcnd.compare.methods import Method

__all__ = ["Pictured", "check_report_libraries", "draw_pictures", "write_report"]

Pictured = Literal["one", "all", "none"]
"""Which cases get pictures: the middle one of each mesh, all, or none."""

_STYLE = """
body { max-width: 88rem } table { font-size: .9rem; margin: .5rem 0 } th { vertical-align: bottom }
.means td { white-space: nowrap }
td:first-child, th:first-child, .failures td, .settings td { text-align: left } .settings td { word-break: break-word }
tr.best td { font-weight: 600; background: #f6efe6 } .failed { color: #b3261e } summary { cursor: pointer }
.shots { display: grid; grid-template-columns: repeat(auto-fill, minmax(205px, 1fr)); gap: 1rem .6rem }
figure { margin: 0 } figure img { display: block; width: 220px; border: 1px solid #eee; margin-bottom: 4px }
figcaption { font-size: .8rem; min-height: 2.9rem; line-height: 1.25; word-break: break-word }
figcaption b { display: block } .scale { font-size: .9rem }
.ramp { display: inline-block; width: 14rem; height: .8rem; vertical-align: middle; background: RAMP }
"""


def check_report_libraries() -> None:
    """Checks that what the page needs is installed, before hours of work.

    Raises:
        GcndError: matplotlib or jinja2 is not.
    """
    try:
        import jinja2  # noqa: F401
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise GcndError(f"the report needs {error.name}", hint="pip install 'gcnd[compare]'") from error


def draw_pictures(
    cases: Sequence[Case],
    rows: Sequence[Row],
    out: Path,
    which: Pictured,
    progress: Callable[[float, str], object] | None = None,
) -> list[tuple[str, CasePictures]]:
    """Draws cases as every method left them.

    Args:
        cases: Of the comparison.
        rows: Of the comparison, without "best of".
        out: Folder with the results.
        which: Cases to draw.
        progress: Called before each with (fraction done, what is drawn).

    Returns:
        A title and the pictures of each.
    """
    unreadable = {row.case for row in rows if row.method == INPUT and row.error is not None}
    chosen = _chosen([c for c in cases if (c.mesh, c.noise, c.level) not in unreadable], which)
    drawn = []
    for number, case in enumerate(chosen):
        title = f"{case.mesh}, {case.noise} {case.level}"
        if progress is not None:
            progress(number / len(chosen), f"pictures: {title}")
        own = [row for row in rows if row.case == (case.mesh, case.noise, case.level) and row.method != INPUT]
        found = {row.method: load_result(out, row) for row in sorted(own, key=lambda row: row.e_a or 0.0)}
        mesh = case.load()
        results = {
            label: vertices
            for label, vertices in found.items()
            if vertices is not None and vertices.shape == mesh.truth.shape
        }
        drawn.append((title, draw_case(mesh, results)))
    return drawn


def _chosen(cases: Sequence[Case], which: Pictured) -> list[Case]:
    if which != "one":
        return list(cases) if which == "all" else []
    by_mesh: dict[str, list[Case]] = {}
    for case in cases:
        by_mesh.setdefault(case.mesh, []).append(case)
    return [of[len(of) // 2] for of in by_mesh.values()]


def write_report(
    path: Path,
    about: Mapping[str, Any],
    methods: Sequence[Method],
    rows: Sequence[Row],
    lines: Sequence[Line],
    pictures: Sequence[tuple[str, CasePictures]],
    skipped: Sequence[str] = (),
) -> None:
    """Writes the page; it opens without a network.

    Args:
        path: File to write.
        about: Versions, hardware and options of the run, ``dataset``, ``threads`` and ``processor`` among them.
        methods: What was run.
        rows: Every row, "best of" included.
        lines: Of `gcnd.compare.summary.summarise`.
        pictures: Of `draw_pictures`.
        skipped: Lines about libraries that are missing.

    Raises:
        GcndError: matplotlib or jinja2 is not installed.
    """
    check_report_libraries()
    from jinja2 import Environment, StrictUndefined

    text = files("gcnd.compare").joinpath("report.html.j2").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    own = [method.label for method in methods if method.source == "gcnd"]
    body = environment.from_string(text).render(
        about=dict(about),
        n_meshes=len({row.case for row in rows if row.method != INPUT or row.error is None}),
        n_methods=len(methods),
        methods=methods,
        noises=[_noise(noise, lines, own) for noise in dict.fromkeys(line.noise for line in lines)],
        failures=[row for row in rows if row.error is not None],
        pictures=[{"title": title, "drawn": drawn} for title, drawn in pictures],
        skipped=list(skipped),
        best_of=_best,
    )
    title = f"gcnd compare: {about['dataset']}"
    page = html_page(title, body, _STYLE.replace("RAMP", _ramp()))
    write_atomic(path, page)


def _noise(noise: str, lines: Sequence[Line], own: Sequence[str]) -> dict[str, Any]:
    mine = [line for line in lines if line.noise == noise]
    whole = [line for line in mine if (line.kind, line.level) == (ALL, ALL)]
    groups: dict[tuple[str, str], list[Line]] = {}
    for line in mine:
        if (line.kind, line.level) != (ALL, ALL):
            groups.setdefault((line.kind, line.level), []).append(line)
    titled = [
        {"title": f"{_kind(kind)}, {'all levels' if level == ALL else f'noise {level}'}", "lines": of}
        for (kind, level), of in groups.items()
    ]
    charts = {"bar_chart": bar_chart(mine, noise), "time_chart": time_chart(whole, own)}
    return {"name": noise, "whole": whole, "groups": titled, **charts}


def _kind(kind: str) -> str:
    return "all kinds" if kind == ALL else kind


def _best(lines: Sequence[Line]) -> str | None:
    """The one method of least mean E_a; what is chosen with the truth in hand is not one method."""
    methods = [line for line in lines if line.e_a is not None and not line.is_choice and line.method != INPUT]
    return min(methods, key=lambda line: line.e_a or 0.0).method if methods else None


def _ramp() -> str:
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    stops = ", ".join(to_hex(colormaps["viridis"](step / 12)) for step in range(13))
    return f"linear-gradient(to right, {stops})"

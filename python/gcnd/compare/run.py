"""Every method on every mesh, in turn: rows are written as they are finished, and a stopped run goes on."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import gcnd
from gcnd.compare.child import run_in_child
from gcnd.compare.measures import measure
from gcnd.compare.rows import INPUT, Row, RowFile, printable
from gcnd.errors import ConfigError, GcndError
from gcnd.formats.atomic import read_npz, write_atomic_npz

if TYPE_CHECKING:
    from gcnd.compare.adapters.base import Vertices
    from gcnd.compare.cases import Case, CaseMesh
    from gcnd.compare.methods import Method

__all__ = ["Conditions", "available_threads", "check_output_folder", "compare", "load_result"]


MOST_SAMPLES = 10_000_000
"""Points on each surface: a few GB of them."""


@dataclass(frozen=True)
class Conditions:
    """Says what is the same for every run.

    Attributes:
        threads: Processors that a method may use.
        timeout: Seconds until a method is ended, its start-up included.
        samples: Points on each surface for E_v.
        retry_failed: Whether rows of an earlier run that failed are run again.
    """

    threads: int
    timeout: float = 600.0
    samples: int = 200_000
    retry_failed: bool = False

    def __post_init__(self) -> None:
        """Checks every value; raises ``ConfigError``."""
        if not 1 <= self.threads <= available_threads():
            message = f"threads is {self.threads}, allowed: 1 to {available_threads()}"
            raise ConfigError(message, hint="this machine lets the process use no more")
        if not (self.timeout > 0 and math.isfinite(self.timeout)):
            raise ConfigError(f"timeout is {self.timeout:g}, allowed: above 0 seconds, and finite")
        if not 1 <= self.samples <= MOST_SAMPLES:
            raise ConfigError(f"samples is {self.samples}, allowed: 1 to {MOST_SAMPLES}")


def available_threads() -> int:
    """Returns how many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def check_output_folder(out: Path) -> None:
    """Checks that a comparison can write to a folder, which need not be there yet; nothing is made.

    Raises:
        ConfigError: It is a file, or cannot be made or written to.
    """
    if out.exists() and not out.is_dir():
        raise ConfigError(f"{out} is a file, not a folder", hint="give --out a new name or a folder")
    nearest = next(path for path in (out, *out.absolute().parents) if path.exists())
    if not nearest.is_dir():
        raise ConfigError(f"cannot make {out}: {nearest} is a file", hint="choose another --out")
    if not os.access(nearest, os.W_OK | os.X_OK):
        what = (
            f"cannot write to {out}"
            if nearest == out
            else f"cannot make {out}: {nearest} cannot be written to"
        )
        raise ConfigError(what, hint="choose another --out")


def compare(
    cases: Sequence[Case],
    methods: Sequence[Method],
    out: Path,
    conditions: Conditions,
    *,
    progress: Callable[[float, str], object] | None = None,
) -> list[Row]:
    """Runs what has not been run yet.

    Args:
        cases: What is denoised.
        methods: What denoises it.
        out: Folder for ``rows.jsonl`` and for the results; made if missing.
        conditions: The same for all.
        progress: Called before each run with (fraction done, what runs); what it raises stops the comparison, and the
            rows that are finished stay.

    Returns:
        A row for the input and one for each method of every case, failures among them. Of a case that cannot be read
        the input's row alone, which is not kept: the next run reads it again.

    Raises:
        ConfigError: The file of rows is damaged.

    Example:
        >>> rows = compare(cases, methods, Path("report"), Conditions(threads=2))  # doctest: +SKIP
    """
    (out / "results").mkdir(parents=True, exist_ok=True)
    kept = RowFile(out / "rows.jsonl")
    rows = []
    total = len(cases) * len(methods)
    for number, case in enumerate(cases):
        try:
            mesh = case.load()
        except GcndError as error:
            rows.append(_unreadable_row(case, error))
            continue
        digest = mesh.digest
        blank = _blank_row(case, len(mesh.faces))
        key = _key(digest, INPUT, gcnd.__version__, conditions)
        rows.append(_called(_input_row(kept, blank, mesh, key, conditions), case))
        for index, method in enumerate(methods):
            if progress is not None:
                label = f"{case.mesh}, {case.noise} {case.level}: {method.label}"
                progress((number * len(methods) + index) / total, label)
            key = _key(digest, repr(method.identity), method.version, conditions)
            row = kept.get(key)
            if row is None or (row.error is not None and conditions.retry_failed):
                row = _run(replace(blank, key=key), method, mesh, out, conditions)
                kept.add(row)
            # Names may change between runs; what was run may not.
            rows.append(_called(replace(row, method=method.label, family=method.family), case))
    return rows


def load_result(out: Path, row: Row) -> Vertices | None:
    """Returns the positions (V, 3) that a row's method gave, to 32 bits; None when there are none that can be read."""
    stored = None if row.error is not None else read_npz(_result_path(out, row.key), "vertices")
    if stored is None or stored["vertices"].dtype.kind != "f":
        return None
    return stored["vertices"].astype(np.float64)


def _result_path(out: Path, key: str) -> Path:
    return out / "results" / f"{key}.npz"


def _key(digest: str, identity: str, version: str, conditions: Conditions) -> str:
    parts = [digest, identity, version, conditions.threads, conditions.samples]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:20]


def _unreadable_row(case: Case, error: GcndError) -> Row:
    text = " ".join(str(error).split())
    return replace(_blank_row(case, 0), error=printable(f"{text} ({error.hint})" if error.hint else text))


def _blank_row(case: Case, n_faces: int) -> Row:
    return Row(
        key="",
        mesh=case.mesh,
        kind=case.kind,
        noise=case.noise,
        level=case.level,
        faces=n_faces,
        method=INPUT,
        family=INPUT,
        source="input",
        version=gcnd.__version__,
        settings={},
    )


def _called(row: Row, case: Case) -> Row:
    return replace(row, mesh=case.mesh, kind=case.kind, noise=case.noise, level=case.level)


def _input_row(kept: RowFile, blank: Row, mesh: CaseMesh, key: str, conditions: Conditions) -> Row:
    row = kept.get(key)
    if row is None:
        row = replace(blank, key=key, **_errors(mesh.noisy, mesh, conditions))
        kept.add(row)
    return row


def _run(row: Row, method: Method, mesh: CaseMesh, out: Path, conditions: Conditions) -> Row:
    row = replace(
        row,
        method=method.label,
        family=method.family,
        source=method.source,
        version=method.version,
        settings=dict(method.settings),
    )
    outcome = run_in_child(
        method, mesh.noisy, mesh.faces, threads=conditions.threads, timeout=conditions.timeout
    )
    if outcome.vertices is None:
        return replace(row, error=outcome.error)
    try:
        errors = _errors(outcome.vertices, mesh, conditions)
    except GcndError as error:
        return replace(row, error=f"cannot be measured: {error}")
    write_atomic_npz(_result_path(out, row.key), vertices=outcome.vertices.astype(np.float32))
    return replace(
        row,
        seconds=outcome.seconds,
        peak_mib=outcome.peak_mib,
        added_mib=outcome.added_mib,
        **errors,
    )


def _errors(vertices: Vertices, mesh: CaseMesh, conditions: Conditions) -> dict[str, Any]:
    """The measures by name; JSON has no NaN, which a truth without any area gives."""
    found = asdict(measure(vertices, mesh.truth, mesh.faces, samples=conditions.samples))
    return {name: None if value is None or value != value else value for name, value in found.items()}

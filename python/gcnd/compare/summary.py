"""Means over meshes by noise, kind and level, and the best of several methods on each mesh."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from statistics import fmean
from typing import Any

from gcnd.compare.rows import INPUT, Row

__all__ = ["ALL", "BEST_CLASSICAL", "Line", "summarise", "with_best"]

ALL = "all"
"""Kind or level of a line that is a mean over all of them."""

BEST_CLASSICAL = "best classical"
"""The best, on each mesh, of the methods of the group ``classical`` that were run."""


_NUMBERS = (
    "seconds",
    "peak_mib",
    "added_mib",
    "e_v",
    "displacement_mean",
    "displacement_max",
    "flipped",
    "volume_change",
)
"""Of a row, besides E_a."""


@dataclass(frozen=True)
class Line:
    """Holds means of one method over the meshes of one noise, kind and level; None where no mesh has a value.

    Attributes:
        noise: Kind of noise.
        kind: Of the meshes, or `ALL`.
        level: Of the noise, or `ALL`.
        method: Label of the method.
        runs: How many there were.
        failed: How many of them failed; the means leave these out.
        e_a: Mean, degrees.
        e_v: Mean, times 1000.
        displacement_mean: Mean over meshes, in mean edge lengths.
        displacement_max: The largest of all.
        flipped: Mean share of faces turned over, in percent.
        volume_change: Mean of the amounts, without their signs, in percent.
        seconds_per_million: Seconds for a million faces: all seconds over all faces.
        peak_mib: The largest of all.
        added_mib: The largest of all.
        is_choice: Whether it is not one method but the best of several on each mesh.
    """

    noise: str
    kind: str
    level: str
    method: str
    runs: int
    failed: int
    e_a: float | None
    e_v: float | None
    displacement_mean: float | None
    displacement_max: float | None
    flipped: float | None
    volume_change: float | None
    seconds_per_million: float | None
    peak_mib: float | None
    added_mib: float | None
    is_choice: bool = False


def with_best(rows: Sequence[Row], classic: Collection[str]) -> list[Row]:
    """Adds to each mesh a row for the best setting of each family with several, and one for the best classical method.

    The best is the one of least E_a, chosen on each mesh with the truth in hand; its other numbers come with it.

    Args:
        rows: Of a comparison.
        classic: Labels of the methods that "best classical" is the best of.

    Returns:
        The rows, then those that were added; ``chosen`` names in these the method that was best.
    """
    members: dict[str, set[str]] = {}
    for row in rows:
        members.setdefault(row.family, set()).add(row.method)
    groups = {f"{family}, best of {len(of)}": of for family, of in members.items() if len(of) > 1}
    if len(classic) > 1:
        groups[BEST_CLASSICAL] = set(classic)
    best = []
    for label, group in groups.items():
        cases: dict[tuple[str, str, str], list[Row]] = {}
        for row in rows:
            if row.method in group:
                cases.setdefault(row.case, []).append(row)
        best += [_best(label, of) for of in cases.values()]
    return [*rows, *best]


def _best(label: str, rows: Sequence[Row]) -> Row:
    good = [row for row in rows if row.e_a is not None]
    if not good:
        # A truth without area has no E_a, whatever a method did.
        error = None if any(row.error is None for row in rows) else "every member failed"
        numbers: dict[str, Any] = dict.fromkeys(_NUMBERS)
        return replace(rows[0], method=label, family=label, error=error, **numbers)
    best = min(good, key=lambda row: row.e_a or 0.0)
    return replace(best, method=label, family=label, chosen=best.method)


def summarise(rows: Iterable[Row]) -> list[Line]:
    """Computes the means of every method by noise, kind and level, and over all kinds and all levels.

    Args:
        rows: Of a comparison, those of `with_best` included.

    Returns:
        Lines by noise, kind and level in the order of the rows, `ALL` last; in each the input first, then by E_a.
    """
    groups: dict[tuple[str, str, str], dict[str, list[Row]]] = {}
    rows = list(rows)
    for noise in _ordered(row.noise for row in rows):
        own = [row for row in rows if row.noise == noise]
        for kind in [*_ordered(row.kind for row in own), ALL]:
            for level in [*_ordered(row.level for row in own), ALL]:
                methods = groups.setdefault((noise, kind, level), {})
                for row in own:
                    if kind in (row.kind, ALL) and level in (row.level, ALL):
                        methods.setdefault(row.method, []).append(row)
    lines = []
    for (noise, kind, level), methods in groups.items():
        table = [_line(noise, kind, level, method, of) for method, of in methods.items()]
        lines += sorted(table, key=_rank)
    return lines


def _rank(line: Line) -> tuple[bool, bool, float]:
    return line.method != INPUT, line.e_a is None, line.e_a or 0.0


def _ordered(values: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(values))


def _line(noise: str, kind: str, level: str, method: str, rows: Sequence[Row]) -> Line:
    good = [row for row in rows if row.error is None]
    timed = [row for row in good if row.seconds is not None]
    seconds = sum(row.seconds or 0.0 for row in timed)
    return Line(
        noise,
        kind,
        level,
        method,
        runs=len(rows),
        failed=len(rows) - len(good),
        e_a=_mean(row.e_a for row in good),
        e_v=_mean(row.e_v for row in good),
        displacement_mean=_mean(row.displacement_mean for row in good),
        displacement_max=_most(row.displacement_max for row in good),
        flipped=_mean(None if row.flipped is None else 100 * row.flipped / row.faces for row in good),
        volume_change=_mean(None if row.volume_change is None else abs(row.volume_change) for row in good),
        seconds_per_million=1e6 * seconds / sum(row.faces for row in timed) if timed else None,
        peak_mib=_most(row.peak_mib for row in good),
        added_mib=_most(row.added_mib for row in good),
        is_choice=any(row.chosen is not None for row in rows),
    )


def _mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return fmean(known) if known else None


def _most(values: Iterable[float | None]) -> float | None:
    return max((value for value in values if value is not None), default=None)

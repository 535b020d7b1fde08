"""Draws E_a by kind of mesh and E_a against time, from what `gcnd compare` wrote.

    gcnd compare builtin --levels 0.2 --seed 7 --methods default,fast,paper,classical --pictures none --out runs/builtin
    python benches/accuracy_chart.py runs/builtin docs/images/accuracy.png --times runs/times

A filter that was run at several settings is drawn at the best of them per mesh and level, chosen with the truth in
hand, and at the mean of their times. Times are those of another report, made on an idle machine, where one is given.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

KINDS = {"cad": "CAD", "smooth": "smooth", "feature": "detailed"}
METHODS = {
    "trimesh:taubin-tuned": ("Taubin", "#d9d5cb"),
    "trimesh:humphrey-tuned": ("Humphrey", "#b9b4a6"),
    "l0": ("L0", "#a9b6c9"),
    "bilateral-normal": ("bilateral normals", "#8698b3"),
    "guided-normal": ("guided normals", "#5f7495"),
    "paper": ("gcnd, paper", "#ecc3a0"),
    "fast": ("gcnd, fast", "#e2916f"),
    "default": ("gcnd, default", "#c8452f"),
}
"""What is drawn, in this order, with its name and colour; a method only where it was run."""

Rows = list[dict]


def settings(rows: Rows, method: str) -> list[str]:
    """The names of a method's runs: itself, or one for each of its settings."""
    return sorted({row["method"] for row in rows if row["method"].split("[")[0] == method})


def mean_error(rows: Rows, method: str) -> float:
    """Mean E_a in degrees; at the best setting per mesh, noise and level."""
    names = settings(rows, method)
    best: dict[tuple, float] = {}
    for row in rows:
        if row["method"] in names:
            case = (row["mesh"], row["noise"], row["level"])
            best[case] = min(row["e_a"], best.get(case, np.inf))
    return float(np.mean(list(best.values())))


def seconds(rows: Rows, method: str) -> float:
    """Seconds for 100,000 faces, in the mean over meshes, levels and settings."""
    names = settings(rows, method)
    own = [row for row in rows if row["method"] in names]
    return 1e5 * sum(row["seconds"] for row in own) / sum(row["faces"] for row in own)


def draw_kinds(axis: Axes, rows: Rows, methods: list[str]) -> None:
    """Bars of mean E_a by kind of mesh."""
    width = 0.86 / len(methods)
    kinds = [kind for kind in KINDS if any(row["kind"] == kind for row in rows)]
    for column, kind in enumerate(kinds):
        chosen = [row for row in rows if row["kind"] == kind]
        for slot, method in enumerate(methods):
            name, colour = METHODS[method]
            place = column + (slot - (len(methods) - 1) / 2) * width
            label = name if column == 0 else None
            bar = axis.bar(place, mean_error(chosen, method), width * 0.92, color=colour, label=label)
            axis.bar_label(bar, fmt="%.1f", fontsize=6, padding=1)
    axis.set_xticks(range(len(kinds)), [KINDS[kind] for kind in kinds])
    axis.set_ylabel("E_a, degrees")
    axis.set_title("error by kind of mesh", fontsize=10)


def draw_times(axis: Axes, rows: Rows, timed: Rows, methods: list[str], threads: int) -> None:
    """Mean E_a against seconds, a point a method."""
    places = {method: (seconds(timed, method), mean_error(rows, method)) for method in methods}
    for method, place in places.items():
        name, colour = METHODS[method]
        # Below where another point lies close above, so that neighbours' names do not meet.
        crowded = any(
            place[1] < error < place[1] + 1.0 and place[0] / 6 < time < place[0] * 6
            for time, error in places.values()
        )
        offset = (0, -14 if crowded else 8)
        axis.scatter(*place, s=60, color=colour, edgecolor="#444444", linewidth=0.6, zorder=3)
        axis.annotate(name, place, xytext=offset, textcoords="offset points", fontsize=7, ha="center")
    axis.set_xscale("log")
    axis.xaxis.set_major_formatter("{x:g}")
    axis.margins(x=0.18, y=0.12)
    axis.set_ylim(bottom=0)
    axis.grid(color="#eeeeee", zorder=0)
    axis.set_xlabel(f"seconds for 100,000 faces, {threads} thread{'s' if threads > 1 else ''}")
    axis.set_title("error against time", fontsize=10)


def report_of(folder: Path) -> tuple[Rows, int]:
    """What was run without an error, and on how many threads."""
    report = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    rows = [row for row in report["rows"] if row["seconds"] is not None and row["error"] is None]
    return rows, report["about"]["threads"]


def main() -> None:
    """Writes the chart and prints what it shows."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("report", type=Path)
    parser.add_argument("chart", type=Path)
    parser.add_argument("--times", type=Path, help="of another report, made on an idle machine")
    options = parser.parse_args()
    rows, _ = report_of(options.report)
    timed, threads = report_of(options.times or options.report)
    methods = [method for method in METHODS if settings(rows, method)]
    figure = Figure(figsize=(11, 3.6), dpi=130, layout="constrained")
    bars, times = figure.subplots(1, 2, width_ratios=(1.75, 1))
    draw_kinds(bars, rows, methods)
    draw_times(times, rows, timed, methods, threads)
    for axis in (bars, times):
        axis.spines[["top", "right"]].set_visible(False)
    figure.legend(
        *bars.get_legend_handles_labels(), loc="outside lower center", ncols=8, frameon=False, fontsize=8
    )
    figure.savefig(options.chart)
    for method in methods:
        print(
            f"{method}: E_a {mean_error(rows, method):.2f}, {seconds(timed, method):.1f} s for 100,000 faces"
        )


if __name__ == "__main__":
    main()

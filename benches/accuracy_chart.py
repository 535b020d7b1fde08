"""Draws E_a by kind of mesh and E_a against time, from what benches/accuracy.py wrote.

python benches/accuracy_chart.py results.json chart.png --preset default --preset fast --preset paper
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from accuracy import CLASSICAL
from matplotlib.axes import Axes
from matplotlib.figure import Figure

KINDS = {"cad": "CAD", "smooth": "smooth", "feature": "detailed"}
FAMILIES = {
    "taubin": ("Taubin", "#d9d5cb"),
    "humphrey": ("Humphrey", "#b9b4a6"),
    "l0": ("L0", "#a9b6c9"),
    "bilateral-normal": ("bilateral normals", "#8698b3"),
    "guided-normal": ("guided normals", "#5f7495"),
    "paper": ("gcnd, paper", "#ecc3a0"),
    "fast": ("gcnd, fast", "#e2916f"),
    "default": ("gcnd, default", "#c8452f"),
}
"""What is drawn, in this order, with its name and colour; a preset only where it was measured."""

Rows = list[dict]


def variants(family: str) -> list[str]:
    """The names in a row that belong to a family: a filter at each of its settings, or the preset itself."""
    return [name for name in CLASSICAL if name.split()[0] == family] or [family]


def mean_error(rows: Rows, family: str) -> float:
    """Mean E_a in degrees; a filter at its best setting per mesh and level, chosen with the truth in hand."""
    return float(np.mean([min(row[name]["e_a"] for name in variants(family)) for row in rows]))


def seconds(rows: Rows, family: str) -> float:
    """Seconds for 100,000 faces, in the mean over meshes, levels and settings."""
    names = variants(family)
    total = sum(row[name]["seconds"] for row in rows for name in names)
    return 1e5 * total / sum(row["faces"] for row in rows) / len(names)


def draw_kinds(axis: Axes, rows: Rows, families: list[str]) -> None:
    """Bars of mean E_a by kind of mesh."""
    width = 0.86 / len(families)
    kinds = [kind for kind in KINDS if any(row["kind"] == kind for row in rows)]
    for column, kind in enumerate(kinds):
        chosen = [row for row in rows if row["kind"] == kind]
        for slot, family in enumerate(families):
            name, colour = FAMILIES[family]
            place = column + (slot - (len(families) - 1) / 2) * width
            label = name if column == 0 else None
            bar = axis.bar(place, mean_error(chosen, family), width * 0.92, color=colour, label=label)
            axis.bar_label(bar, fmt="%.1f", fontsize=6, padding=1)
    axis.set_xticks(range(len(kinds)), [KINDS[kind] for kind in kinds])
    axis.set_ylabel("E_a, degrees")
    axis.set_title("error by kind of mesh", fontsize=10)


def draw_times(axis: Axes, rows: Rows, families: list[str]) -> None:
    """Mean E_a against seconds, a point a method."""
    for turn, family in enumerate(sorted(families, key=lambda family: seconds(rows, family))):
        name, colour = FAMILIES[family]
        place = (seconds(rows, family), mean_error(rows, family))
        # Above and below by turns, so that neighbours' names do not meet.
        offset = (0, 8 if turn % 2 else -14)
        axis.scatter(*place, s=60, color=colour, edgecolor="#444444", linewidth=0.6, zorder=3)
        axis.annotate(name, place, xytext=offset, textcoords="offset points", fontsize=7, ha="center")
    axis.set_xscale("log")
    axis.xaxis.set_major_formatter("{x:g}")
    axis.margins(x=0.18, y=0.12)
    axis.set_ylim(bottom=0)
    axis.grid(color="#eeeeee", zorder=0)
    axis.set_xlabel("seconds for 100,000 faces, two cores")
    axis.set_title("error against time", fontsize=10)


def main() -> None:
    """Writes the chart and prints what it shows."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("results", type=Path)
    parser.add_argument("chart", type=Path)
    parser.add_argument("--preset", action="append", required=True, choices=["paper", "fast", "default"])
    parser.add_argument("--source", default="val", help="val or procedural")
    options = parser.parse_args()
    rows = [
        row
        for key, row in json.loads(options.results.read_text()).items()
        if key.startswith(options.source)
        and row["noise"] == "gaussian"
        and all(p in row for p in options.preset)
    ]
    classical = {name.split()[0] for name in CLASSICAL}
    families = [family for family in FAMILIES if family in classical or family in options.preset]
    figure = Figure(figsize=(11, 3.6), dpi=130, layout="constrained")
    bars, times = figure.subplots(1, 2, width_ratios=(1.75, 1))
    draw_kinds(bars, rows, families)
    draw_times(times, rows, families)
    for axis in (bars, times):
        axis.spines[["top", "right"]].set_visible(False)
    figure.legend(
        *bars.get_legend_handles_labels(), loc="outside lower center", ncols=8, frameon=False, fontsize=8
    )
    figure.savefig(options.chart)
    for family in families:
        print(
            f"{family}: E_a {mean_error(rows, family):.2f}, {seconds(rows, family):.1f} s for 100,000 faces"
        )


if __name__ == "__main__":
    main()

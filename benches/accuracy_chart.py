"""Draws mean E_a by kind and level from what benches/accuracy.py wrote.

python benches/accuracy_chart.py results.json chart.png --preset default
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

CLASSICAL = ("bilateral-normal", "guided-normal", "l0", "taubin", "humphrey")
COLOURS = {"noisy": "#c9c5bd", "best classical": "#7d8aa5", "gcnd": "#c8553d"}


def means(rows: list[dict], preset: str) -> dict[str, float]:
    """Mean E_a of the noisy input, of the best classical filter per mesh and level, and of the preset."""
    return {
        "noisy": float(np.mean([row["noisy"]["e_a"] for row in rows])),
        "best classical": float(
            np.mean([min(v["e_a"] for k, v in row.items() if k.startswith(CLASSICAL)) for row in rows])
        ),
        "gcnd": float(np.mean([row[preset]["e_a"] for row in rows])),
    }


def main() -> None:
    """Writes the chart."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("results", type=Path)
    parser.add_argument("chart", type=Path)
    parser.add_argument("--preset", default="default")
    parser.add_argument("--source", default="val", help="val or procedural")
    options = parser.parse_args()
    rows = {
        key: row
        for key, row in json.loads(options.results.read_text()).items()
        if key.startswith(options.source) and row["noise"] == "gaussian" and options.preset in row
    }
    kinds = [kind for kind in ("cad", "smooth", "feature") if any(r["kind"] == kind for r in rows.values())]
    figure = Figure(figsize=(4 * len(kinds), 3.2), dpi=130, layout="constrained")
    axes = figure.subplots(1, len(kinds), squeeze=False)[0]
    for kind, axis in zip(kinds, axes, strict=True):
        levels = sorted({row["level"] for row in rows.values()})
        for column, level in enumerate(levels):
            chosen = [row for row in rows.values() if row["kind"] == kind and row["level"] == level]
            for slot, (name, value) in enumerate(means(chosen, options.preset).items()):
                bar = axis.bar(column + (slot - 1) * 0.27, value, 0.25, color=COLOURS[name], label=name)
                axis.bar_label(bar, fmt="%.1f", fontsize=7)
        axis.set_xticks(range(len(levels)), [f"noise {level}" for level in levels])
        axis.set_title({"cad": "CAD", "smooth": "smooth", "feature": "detailed"}[kind], fontsize=11)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("E_a, degrees")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles[:3], labels[:3], loc="outside lower center", ncols=3, frameon=False)
    figure.savefig(options.chart)


if __name__ == "__main__":
    main()

"""Draws mean E_a by kind and level, and seconds, from what benches/accuracy.py wrote.

python benches/accuracy_chart.py results.json chart.png --preset fast --preset default
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from accuracy import CLASSICAL, best_classical
from matplotlib.figure import Figure

COLOURS = ("#c9c5bd", "#7d8aa5", "#e2a08a", "#c8553d", "#8c2f1b")


def means(rows: list[dict], presets: list[str]) -> dict[str, float]:
    """Mean E_a of the noisy input, of the best classical filter per mesh and level, and of the presets."""
    return {
        "noisy": float(np.mean([row["noisy"]["e_a"] for row in rows])),
        "best classical": float(np.mean([best_classical(row) for row in rows])),
        **{f"gcnd, {preset}": float(np.mean([row[preset]["e_a"] for row in rows])) for preset in presets},
    }


def seconds(rows: list[dict], method: str) -> float:
    """Seconds of a method for 100,000 faces, in the mean over meshes and levels."""
    return 1e5 * sum(row[method]["seconds"] for row in rows) / sum(row["faces"] for row in rows)


def main() -> None:
    """Writes the chart."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("results", type=Path)
    parser.add_argument("chart", type=Path)
    parser.add_argument("--preset", action="append", required=True)
    parser.add_argument("--source", default="val", help="val or procedural")
    options = parser.parse_args()
    rows = {
        key: row
        for key, row in json.loads(options.results.read_text()).items()
        if key.startswith(options.source)
        and row["noise"] == "gaussian"
        and all(p in row for p in options.preset)
    }
    kinds = [kind for kind in ("cad", "smooth", "feature") if any(r["kind"] == kind for r in rows.values())]
    figure = Figure(figsize=(4 * len(kinds), 3.2), dpi=130, layout="constrained")
    axes = figure.subplots(1, len(kinds), squeeze=False)[0]
    for kind, axis in zip(kinds, axes, strict=True):
        levels = sorted({row["level"] for row in rows.values()})
        for column, level in enumerate(levels):
            chosen = [row for row in rows.values() if row["kind"] == kind and row["level"] == level]
            bars = means(chosen, options.preset)
            step = 0.85 / len(bars)
            for slot, (name, value) in enumerate(bars.items()):
                place = column + (slot - (len(bars) - 1) / 2) * step
                bar = axis.bar(place, value, step * 0.92, color=COLOURS[slot], label=name)
                axis.bar_label(bar, fmt="%.1f", fontsize=6)
        axis.set_xticks(range(len(levels)), [f"noise {level}" for level in levels])
        axis.set_title({"cad": "CAD", "smooth": "smooth", "feature": "detailed"}[kind], fontsize=11)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("E_a, degrees")
    handles, labels = axes[0].get_legend_handles_labels()
    n = 2 + len(options.preset)
    figure.legend(handles[:n], labels[:n], loc="outside lower center", ncols=n, frameon=False)
    figure.savefig(options.chart)
    for method in (*CLASSICAL, *options.preset):
        error = np.mean([row[method]["e_a"] for row in rows.values()])
        print(f"{method}: E_a {error:.2f}, {seconds(list(rows.values()), method):.1f} s for 100,000 faces")


if __name__ == "__main__":
    main()

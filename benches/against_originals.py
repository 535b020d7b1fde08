"""The filters against what the authors' programs made of the same noisy meshes, at the same settings.

    python benches/against_originals.py DIR

DIR holds ``<case>_noisy.ply`` and ``<case>_truth.ply`` with the same faces, and ``results.csv`` with the columns
``case,method,parameters,E_a_deg``: a row for each result of a program, E_a in degrees. Methods are BMF, BNF (local
scheme), GNF, FE, L0, LR and TGV; rows of others, such as the noise itself, are left out. Parameters are read as
``5 iterations``, ``sigma_r=0.35``, ``sigma_M=0.3``, ``T=0.5``, ``radius multiple 2``, ``20+20`` (passes over normals
and over vertices) and ``lambda=0.2 e^2 gamma; alpha=0.1 gamma``, parted by semicolons; what is in brackets is left
out, and ``not known`` stands for our defaults.

Prints a table of all rows, those in bold where ours is worse by more than 5 %, and a table by method.
"""

from __future__ import annotations

import argparse
import csv
import re
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from gcnd.filters import apply_filter
from gcnd.mesh_io import load
from gcnd.metrics import normal_error

METHODS = {
    "BMF": "bilateral",
    "BNF": "bilateral-normal",
    "GNF": "guided-normal",
    "FE": "fast-effective",
    "L0": "l0",
    "LR": "low-rank",
    "TGV": "tgv",
}
ALLOWED = 1.05

_NUMBER = r"(\d+(?:\.\d+)?)"
# What a setting says of a filter's parameters; what is the filters' default in any case says nothing.
_SETTINGS: tuple[tuple[str, tuple[tuple[str, type], ...]], ...] = (
    (_NUMBER + r" iterations", (("iterations", int),)),
    (r"sigma_r=" + _NUMBER, (("sigma_r", float),)),
    (r"sigma_M=" + _NUMBER, (("sigma_m", float),)),
    (r"T=" + _NUMBER, (("threshold", float),)),
    (r"radius multiple " + _NUMBER, (("radius", float),)),
    (r"(\d+)\+(\d+)", (("normal_iterations", int), ("vertex_iterations", int))),
    (r"local scheme|not known", ()),
    (r"lambda=0\.2 e\^2 gamma", ()),
    (r"alpha=0\.1 gamma", ()),
)


class Row(NamedTuple):
    """One result of a program and of ours: E_a in degrees."""

    case: str
    method: str
    settings: str
    theirs: float
    ours: float

    @property
    def ratio(self) -> float:
        """Ours over theirs."""
        return self.ours / self.theirs

    @property
    def is_worse(self) -> bool:
        """Whether ours is worse by more than what is allowed."""
        return self.ratio > ALLOWED


def parameters(settings: str) -> dict[str, Any]:
    """The parameters of our filter for the settings of a program.

    >>> parameters("local scheme; sigma_r=0.35; 20+10")
    {'sigma_r': 0.35, 'normal_iterations': 20, 'vertex_iterations': 10}
    """
    found: dict[str, Any] = {}
    for setting in re.sub(r"\(.*?\)", "", settings).split(";"):
        for pattern, names in _SETTINGS:
            match = re.fullmatch(pattern, setting.strip())
            if match:
                found.update(
                    (name, kind(text)) for (name, kind), text in zip(names, match.groups(), strict=True)
                )
                break
        else:
            raise SystemExit(f"error: the setting {setting.strip()!r} of results.csv is not known")
    return found


def rows(folder: Path) -> Iterator[Row]:
    """Runs our filters, in the order of ``results.csv``."""
    with (folder / "results.csv").open(newline="", encoding="utf-8") as file:
        lines = [line for line in csv.DictReader(file) if line["method"] in METHODS]
    for line in lines:
        case, method, settings = line["case"], line["method"], line["parameters"]
        noisy, truth = (load(folder / f"{case}_{kind}.ply") for kind in ("noisy", "truth"))
        ours = apply_filter(noisy, METHODS[method], **parameters(settings))
        error = normal_error(ours.vertices, truth.vertices, truth.faces)
        yield Row(case, method, settings, float(line["E_a_deg"]), error)


def row_line(row: Row) -> str:
    """A row of the table; in bold where ours is worse by more than what is allowed."""
    ratio = f"**{row.ratio:.3f}**" if row.is_worse else f"{row.ratio:.3f}"
    return f"| {row.case} | {row.method} | {row.settings} | {row.theirs:.2f} | {row.ours:.2f} | {ratio} |"


def method_lines(found: list[Row]) -> list[str]:
    """The table by method."""
    lines = ["| method | rows | median ratio | worst | above 1.05 |", "|---|---|---|---|---|"]
    for method in (name for name in METHODS if any(row.method == name for row in found)):
        ratios = [row.ratio for row in found if row.method == method]
        worse = sum(row.is_worse for row in found if row.method == method)
        line = f"| {METHODS[method]} | {len(ratios)} | {median(ratios):.3f} | {max(ratios):.3f} | {worse} |"
        lines.append(line)
    return lines


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, metavar="DIR")
    options = parser.parse_args()
    print("| mesh | method | settings | E_a, original | E_a, ours | ratio |\n|---|---|---|---|---|---|")
    found = []
    for row in rows(options.folder):
        found.append(row)
        print(row_line(row), flush=True)
    worse = sum(row.is_worse for row in found)
    print(f"\n{len(found) - worse} of {len(found)} within 5 % or better\n")
    print("\n".join(method_lines(found)))


if __name__ == "__main__":
    main()

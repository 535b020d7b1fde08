"""Arguments and options that several commands share."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer

__all__ = ["InputMesh", "JsonFlag", "OutputMesh", "Seed", "TriangulateFlag", "print_json", "print_table"]

# Plain paths, checked by mesh_io: its errors carry hints, and exit code 2 is for a wrong command line.
InputMesh: TypeAlias = Annotated[
    Path, typer.Argument(metavar="IN", help="Mesh file: .ply, .obj, .stl, .off or .glb.", show_default=False)
]
OutputMesh: TypeAlias = Annotated[
    Path,
    typer.Argument(metavar="OUT", help="File to write; its extension gives the format.", show_default=False),
]
Seed: TypeAlias = Annotated[int, typer.Option(min=0, help="Seed of every random choice.")]
TriangulateFlag: TypeAlias = Annotated[
    bool, typer.Option("--triangulate", help="Split faces of more than three corners for the work.")
]
JsonFlag: TypeAlias = Annotated[bool, typer.Option("--json", help="Print JSON.")]


def print_json(value: Any) -> None:
    """Prints a value as indented JSON on stdout; JSON has no NaN or infinity, which become null.

    In ASCII, since the terminal or the reader of a pipe may have any encoding, and names of files any bytes.
    """
    print(json.dumps(_without_nan(value), indent=2, allow_nan=False))


def _without_nan(value: Any) -> Any:
    match value:
        case Mapping():
            return {key: _without_nan(member) for key, member in value.items()}
        case list():
            return [_without_nan(member) for member in value]
        case float() if not math.isfinite(value):
            return None
        case _:
            return value


def print_table(rows: Mapping[str, Any]) -> None:
    """Prints names and values in two columns on stdout."""
    width = max(len(name) for name in rows)
    for name, value in rows.items():
        print(f"{name:<{width}}  {value}")

"""`gcnd noise`: a clean mesh made noisy, to test with."""

from __future__ import annotations

from enum import Enum
from typing import Annotated

import typer

from gcnd.cli.options import InputMesh, OutputMesh, Seed

__all__ = ["NoiseKind", "run"]


class NoiseKind(str, Enum):
    """How the vertices move; the names are those of `gcnd.data.noise`."""

    GAUSSIAN = "gaussian"
    IMPULSIVE = "impulsive"
    ISOTROPIC = "isotropic"


def run(
    input_mesh: InputMesh,
    output_mesh: OutputMesh,
    level: Annotated[
        float, typer.Option(min=0.0, help="Standard deviation in mean edge lengths.", show_default=False)
    ],
    kind: Annotated[
        NoiseKind,
        typer.Option(
            help="gaussian: all vertices along their normals; impulsive: some of them; isotropic: all, in "
            "any direction."
        ),
    ] = NoiseKind.GAUSSIAN,
    fraction: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Fraction of the vertices that impulsive noise moves.")
    ] = 0.3,
    seed: Seed = 0,
) -> None:
    """Add noise to the vertices of IN and write the result to OUT."""
    from gcnd.data.noise import add_noise
    from gcnd.mesh_io import check_output_path, load, save, to_arrays

    check_output_path(output_mesh, input_mesh)
    arrays, rebuild = to_arrays(load(input_mesh))
    moved = add_noise(
        arrays.vertices, arrays.faces, kind=kind.value, level=level, fraction=fraction, seed=seed
    )
    save(rebuild(moved), output_mesh)

"""`gcnd evaluate`: how far a result is from the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gcnd.cli.options import JsonFlag, Seed, print_json, print_table

__all__ = ["run"]

_HINT = "compare a result with the truth of the same mesh, both in a format with vertex order, such as PLY"


def run(
    result_mesh: Annotated[Path, typer.Argument(metavar="RESULT", help="The denoised mesh.")],
    truth_mesh: Annotated[Path, typer.Argument(metavar="TRUTH", help="The clean mesh, with the same faces.")],
    as_json: JsonFlag = False,
    samples: Annotated[int, typer.Option(min=1, help="Points sampled on each surface for E_v.")] = 200_000,
    seed: Seed = 0,
) -> None:
    """Print the normal error E_a (degrees) and the vertex error E_v (times 1000) of RESULT against TRUTH."""
    from gcnd.mesh_io import read_shape
    from gcnd.same_faces import split_alike

    true_shape = read_shape(truth_mesh)
    truth = true_shape.arrays
    result = split_alike(read_shape(result_mesh), true_shape, ("RESULT", "TRUTH"), _HINT)
    from gcnd.metrics import normal_error, vertex_error

    degrees = normal_error(result.vertices, truth.vertices, truth.faces)
    distance = vertex_error(result.vertices, result.faces, truth.vertices, truth.faces, samples, seed)
    if as_json:
        print_json(
            {
                "normal_error_degrees": degrees,
                "vertex_error_times_1000": distance * 1e3,
                "faces": len(truth.faces),
                "samples": samples,
                "seed": seed,
            }
        )
    else:
        print_table({"E_a": f"{degrees:.4f} degrees", "E_v": f"{distance * 1e3:.4f} (times 1000)"})

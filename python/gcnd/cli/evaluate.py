"""`gcnd evaluate`: how far a result is from the truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gcnd.cli.options import JsonFlag, Seed, print_json, print_table

if TYPE_CHECKING:
    from gcnd.mesh_io import MeshArrays

__all__ = ["run"]


def run(
    result_mesh: Annotated[Path, typer.Argument(metavar="RESULT", help="The denoised mesh.")],
    truth_mesh: Annotated[Path, typer.Argument(metavar="TRUTH", help="The clean mesh, with the same faces.")],
    as_json: JsonFlag = False,
    samples: Annotated[int, typer.Option(min=1, help="Points sampled on each surface for E_v.")] = 200_000,
    seed: Seed = 0,
) -> None:
    """Print the normal error E_a (degrees) and the vertex error E_v (times 1000) of RESULT against TRUTH."""
    from gcnd.mesh_io import to_arrays

    result, _ = to_arrays(result_mesh)
    truth, _ = to_arrays(truth_mesh)
    _require_same_faces(result, truth)
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


def _require_same_faces(result: MeshArrays, truth: MeshArrays) -> None:
    """Raises unless both meshes have the same faces in the same order: E_a compares face i with face i."""
    from gcnd.errors import MeshError

    hint = "compare a result with the truth of the same mesh, both in a format with vertex order, such as PLY"
    if len(result.faces) != len(truth.faces):
        raise MeshError(f"RESULT has {len(result.faces)} faces and TRUTH has {len(truth.faces)}", hint)
    differs = (result.faces != truth.faces).any(axis=1)
    if differs.any():
        face_id = int(differs.argmax())
        corners = [tuple(mesh.faces[face_id].tolist()) for mesh in (result, truth)]
        raise MeshError(f"face {face_id} is {corners[0]} in RESULT and {corners[1]} in TRUTH", hint)

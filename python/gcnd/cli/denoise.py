"""`gcnd denoise`: one noisy mesh in, one clean mesh out."""

from __future__ import annotations

import sys
import time
from enum import Enum
from typing import Annotated

import typer

from gcnd.cli.options import InputMesh, JsonFlag, OutputMesh, Seed, print_json
from gcnd.cli.progress import show_progress

__all__ = ["run"]


class Device(str, Enum):
    """Where the network runs."""

    CPU = "cpu"
    CUDA = "cuda"


def run(
    input_mesh: InputMesh,
    output_mesh: OutputMesh,
    preset: Annotated[str, typer.Option(help="Weights and settings; see `gcnd models`.")] = "default",
    device: Annotated[Device, typer.Option(help="Where the network runs.")] = Device.CPU,
    seed: Seed = 0,
    normal_iterations: Annotated[
        int | None,
        typer.Option(min=0, help="Passes of normal refinement; by default the preset's.", show_default=False),
    ] = None,
    vertex_iterations: Annotated[
        int | None,
        typer.Option(min=0, help="Passes of vertex updating; by default the preset's.", show_default=False),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress.")] = False,
    as_json: JsonFlag = False,
) -> None:
    """Remove the noise of IN and write the result to OUT."""
    from gcnd.mesh_io import check_output_path, load, save

    check_output_path(output_mesh, input_mesh)
    start = time.perf_counter()
    mesh = load(input_mesh)
    # After loading: torch takes seconds to import, and a wrong file should be told at once.
    from gcnd.denoise import denoise

    with show_progress(quiet=quiet) as progress:
        result = denoise(
            mesh,
            preset=preset,
            device=device.value,
            seed=seed,
            normal_iterations=normal_iterations,
            vertex_iterations=vertex_iterations,
            progress=progress,
        )
    save(result, output_mesh)
    seconds = time.perf_counter() - start
    if as_json:
        print_json(
            {
                "input": str(input_mesh),
                "output": str(output_mesh),
                "vertices": len(mesh.vertices),
                "faces": len(mesh.faces),
                "preset": preset,
                "device": device.value,
                "seed": seed,
                "seconds": round(seconds, 3),
            }
        )
    elif not quiet:
        print(f"wrote {output_mesh}: {len(mesh.faces):,} faces in {seconds:.1f} s", file=sys.stderr)

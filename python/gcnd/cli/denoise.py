"""`gcnd denoise`: one noisy mesh in, one clean mesh out."""

from __future__ import annotations

import sys
import time
from enum import Enum
from typing import Annotated, Any

import typer

from gcnd.cli.options import InputMesh, JsonFlag, OutputMesh, Seed, print_json
from gcnd.cli.progress import ProgressCallback, show_progress
from gcnd.errors import ConfigError

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
    method: Annotated[
        str | None,
        typer.Option(
            help="A classical filter in the network's place, such as guided-normal.", show_default=False
        ),
    ] = None,
    param: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE", help="A parameter of the filter; may be repeated.", show_default=False
        ),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress.")] = False,
    as_json: JsonFlag = False,
) -> None:
    """Remove the noise of IN and write the result to OUT."""
    from gcnd.mesh_io import check_output_path, load, save

    check_output_path(output_mesh, input_mesh)
    iterations = {"normal_iterations": normal_iterations, "vertex_iterations": vertex_iterations}
    settings: dict[str, Any]
    if method is None:
        if param:
            raise ConfigError("--param is for filters", hint="name a filter with --method")
        settings = {"preset": preset, "device": device.value, "seed": seed}
        options = iterations
    else:
        if preset != "default":
            raise ConfigError("--preset and --method exclude each other", hint="give one of the two")
        options = _filter_options(method, param or [], iterations)
        settings = {"method": method, "parameters": options}
    start = time.perf_counter()
    mesh = load(input_mesh)
    with show_progress(quiet=quiet) as progress:
        result = _denoised(mesh, method, settings, options, progress)
    save(result, output_mesh)
    seconds = time.perf_counter() - start
    if as_json:
        print_json(
            {
                "input": str(input_mesh),
                "output": str(output_mesh),
                "vertices": len(mesh.vertices),
                "faces": len(mesh.faces),
                **settings,
                "seconds": round(seconds, 3),
            }
        )
    elif not quiet:
        print(f"wrote {output_mesh}: {len(mesh.faces):,} faces in {seconds:.1f} s", file=sys.stderr)


def _denoised(
    mesh: Any,
    method: str | None,
    settings: dict[str, Any],
    options: dict[str, Any],
    progress: ProgressCallback,
) -> Any:
    if method is not None:
        from gcnd.filters import apply_filter

        return apply_filter(mesh, method, progress=progress, **options)
    # After loading: torch takes seconds to import, and a wrong file should be told at once.
    from gcnd.denoise import denoise

    return denoise(mesh, **settings, **options, progress=progress)


def _filter_options(method: str, texts: list[str], iterations: dict[str, int | None]) -> dict[str, Any]:
    """The filter's parameters from `--param` and from the options that have the same name."""
    from gcnd.filters import parse_parameters

    values = {name: str(count) for name, count in iterations.items() if count is not None}
    for text in texts:
        name, equals, value = text.partition("=")
        if not (name and equals):
            raise ConfigError(f"--param is {text!r}, allowed: NAME=VALUE")
        values[name.strip().replace("-", "_")] = value.strip()
    return parse_parameters(method, values)

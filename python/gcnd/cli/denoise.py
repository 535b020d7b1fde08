"""`gcnd denoise`: one noisy mesh in, one clean mesh out; or a folder of them."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gcnd.cli.interrupt import nothing_to_lose, tidying_up
from gcnd.cli.options import JsonFlag, Seed, TriangulateFlag, print_json
from gcnd.cli.progress import show_progress
from gcnd.errors import ConfigError, MeshError

if TYPE_CHECKING:
    from gcnd.runs import Method

__all__ = ["Request", "run"]


class Device(str, Enum):
    """Where the network runs."""

    CPU = "cpu"
    CUDA = "cuda"


class Boundary(str, Enum):
    """How vertices on a boundary move."""

    FREE = "free"
    ALONG = "along"
    FIXED = "fixed"


@dataclass(frozen=True)
class Request:
    """What the command line asked for.

    Attributes:
        settings: Of the preset or the filter, as they are printed.
        options: What `Denoiser` or `Filter` takes besides the controls.
        controls: What `Controls` takes.
        confidence: Whether to write the confidence by face.
        report: Where to write the report, or None.
        triangulate: Whether faces of more than three corners are split for the work.
    """

    settings: dict[str, Any]
    options: dict[str, Any]
    controls: dict[str, Any]
    confidence: bool
    report: Path | None
    triangulate: bool

    def method(self) -> Method:
        """Makes ready what runs; torch is imported for a preset only."""
        from gcnd.controls import Controls

        controls = Controls(**self.controls)
        if "method" in self.settings:
            from gcnd.filters import Filter

            name = self.settings["method"]
            return Filter(name, controls=controls, triangulate=self.triangulate, **self.options)
        from gcnd.denoiser import Denoiser

        shared: dict[str, Any] = {"controls": controls, "triangulate": self.triangulate}
        denoiser = Denoiser(**self.settings, **self.options, **shared)
        if self.confidence:
            denoiser.check_confidence()
        return denoiser


def run(
    input_path: Annotated[
        Path,
        typer.Argument(metavar="IN", help="Mesh file (.ply, .obj, .stl, .off, .glb), or a folder of them."),
    ],
    output_path: Annotated[
        Path,
        typer.Argument(
            metavar="OUT", help="File to write, its extension gives the format; for a folder, a folder."
        ),
    ],
    preset: Annotated[
        str, typer.Option(help="Weights and settings, see `gcnd models`; auto chooses by the mesh.")
    ] = "auto",
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
    boundary: Annotated[
        Boundary | None,
        typer.Option(
            help="Vertices on a boundary: free like all others, along the surface's normal only, or fixed; "
            "by default along, and what a filter has.",
            show_default=False,
        ),
    ] = None,
    triangulate: TriangulateFlag = False,
    strength: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Share of the result: 0 keeps the input, 1 is all of it.")
    ] = 1.0,
    max_displacement: Annotated[
        float | None,
        typer.Option(min=0.0, help="No vertex moves further, in mesh units.", show_default=False),
    ] = None,
    max_displacement_edges: Annotated[
        float | None,
        typer.Option(min=0.0, help="No vertex moves further, in mean edge lengths.", show_default=False),
    ] = None,
    keep: Annotated[
        str | None,
        typer.Option(
            metavar="ATTRIBUTE",
            help="Leave vertices untouched where this vertex attribute is not 0.",
            show_default=False,
        ),
    ] = None,
    preserve_volume: Annotated[
        bool, typer.Option("--preserve-volume", help="Keep the volume of closed meshes.")
    ] = False,
    confidence: Annotated[
        bool,
        typer.Option("--confidence", help="Write how far predictions agree, as a face attribute (PLY)."),
    ] = False,
    report: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write what ran and what it changed, as JSON.", show_default=False),
    ] = None,
    overwrite: Annotated[
        bool,
        typer.Option(
            "--overwrite",
            help="For a folder: work again on what is done; a single OUT is always written anew.",
        ),
    ] = False,
    ray: Annotated[
        bool, typer.Option("--ray", help="For a folder: work on a Ray cluster (gcnd\\[ray]).")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress.")] = False,
    as_json: JsonFlag = False,
) -> None:
    """Remove the noise of IN and write the result to OUT."""
    iterations = {"normal_iterations": normal_iterations, "vertex_iterations": vertex_iterations}
    settings: dict[str, Any]
    options: dict[str, Any]
    if method is None:
        if param:
            raise ConfigError("--param is for filters", hint="name a filter with --method")
        settings, options = {"preset": preset, "device": device.value, "seed": seed}, dict(iterations)
        if boundary is not None:
            options["boundary"] = boundary.value
    else:
        from gcnd.filters import all_parameters

        if preset != "auto":
            raise ConfigError("--preset and --method exclude each other", hint="give one of the two")
        if confidence:
            raise ConfigError("--confidence is for presets: filters predict nothing")
        options = _filter_options(method, param or [], iterations, boundary)
        settings = {"method": method, "parameters": all_parameters(method, options)}
    controls = {
        "strength": strength,
        "max_displacement": max_displacement,
        "max_displacement_edges": max_displacement_edges,
        "keep": keep,
        "preserve_volume": preserve_volume,
    }
    request = Request(settings, options, controls, confidence, report, triangulate)
    if not input_path.exists():
        # First of all: a folder that is not there would be taken for a file, and its output for a wrong one.
        what = "file" if input_path.suffix else "file or folder"
        raise MeshError(f"no such {what}: {input_path}", "check the spelling and the folder")
    if input_path.is_dir():
        from gcnd.cli.denoise_folder import run_folder

        run_folder(
            input_path, output_path, request, overwrite=overwrite, ray=ray, quiet=quiet, as_json=as_json
        )
    else:
        if ray:
            raise ConfigError("--ray is for folders", hint="name a folder of meshes")
        _run_file(input_path, output_path, request, quiet=quiet, as_json=as_json)


def _run_file(input_mesh: Path, output_mesh: Path, request: Request, *, quiet: bool, as_json: bool) -> None:
    with nothing_to_lose():
        from gcnd.formats.referred import paths_of_referred
        from gcnd.mesh_io import check_input_path, check_output_path
        from gcnd.report import write_report
        from gcnd.results import check_confidence_path, load_source, write_denoised

        check_input_path(input_mesh)
        check_output_path(output_mesh, input_mesh)
        if request.confidence:
            check_confidence_path(output_mesh)
        if request.report is not None:
            check_output_path(request.report, input_mesh, output_mesh, is_mesh=False)
        start = time.perf_counter()
        # Before torch, which takes seconds to import: a wrong file should be told at once.
        mesh = load_source(
            input_mesh, output_mesh, triangulate=request.triangulate, confidence=request.confidence
        )
        if request.report is not None:
            referred = paths_of_referred(input_mesh, output_mesh)
            check_output_path(request.report, *referred, is_mesh=False)
        method = request.method()
    loading = time.perf_counter() - start
    with tidying_up():
        with show_progress(quiet=quiet) as progress:
            done = method.run(mesh, progress=progress)
        writing = time.perf_counter()
        write_denoised(done, output_mesh, source=input_mesh, confidence=request.confidence)
        seconds = time.perf_counter() - start
        if request.report is not None:
            done.seconds["loading"] = loading
            done.seconds["writing"] = time.perf_counter() - writing
            files = {"input": str(input_mesh), "output": str(output_mesh)}
            write_report(request.report, files | done.report())
    if as_json:
        print_json(
            {
                "input": str(input_mesh),
                "output": str(output_mesh),
                "vertices": len(mesh.vertices),
                "faces": len(mesh.faces),
                **request.settings,
                **{name: done.method[name] for name in ("preset", "why") if name in done.method},
                "seconds": round(seconds, 3),
            }
        )
    elif not quiet:
        if "why" in done.method:
            print(f"preset {done.method['preset']}: {done.method['why']}", file=sys.stderr)
        print(f"wrote {output_mesh}: {len(mesh.faces):,} faces in {seconds:.1f} s", file=sys.stderr)


def _filter_options(
    method: str, texts: list[str], iterations: dict[str, int | None], boundary: Boundary | None
) -> dict[str, Any]:
    """The filter's parameters from `--param` and from the options that say the same."""
    from gcnd.filters import parse_parameters

    values = {name: str(count) for name, count in iterations.items() if count is not None}
    if boundary is Boundary.ALONG:
        raise ConfigError("--boundary along is for presets", hint="filters know --boundary free and fixed")
    if boundary is not None:
        values["fix_boundary"] = "true" if boundary is Boundary.FIXED else "false"
    for text in texts:
        name, equals, value = text.partition("=")
        if not (name and equals):
            raise ConfigError(f"--param is {text!r}, allowed: NAME=VALUE")
        values[name.strip().replace("-", "_")] = value.strip()
    return parse_parameters(method, values)

"""`gcnd noise`: a clean mesh made noisy, to test with."""

from __future__ import annotations

import os
import warnings
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gcnd.cli.options import InputMesh, OutputMesh, Seed, TriangulateFlag
from gcnd.errors import ConfigError, MeshWarning

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from gcnd.meshes.arrays import MeshArrays
    from gcnd.scans import ScanKind

__all__ = ["NoiseKind", "run"]


class NoiseKind(str, Enum):
    """How the vertices move; the names are those of `gcnd.data.noise` and `gcnd.scans`."""

    GAUSSIAN = "gaussian"
    IMPULSIVE = "impulsive"
    ISOTROPIC = "isotropic"
    KINECT1 = "kinect1"
    KINECT2 = "kinect2"
    FUSION = "fusion"
    PRINT = "print"


_SCANS: dict[NoiseKind, ScanKind] = {
    NoiseKind.KINECT1: "kinect1",
    NoiseKind.KINECT2: "kinect2",
    NoiseKind.FUSION: "fusion",
    NoiseKind.PRINT: "print",
}


def run(
    input_mesh: InputMesh,
    output_mesh: OutputMesh,
    level: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="Standard deviation in mean edge lengths; scans have their own.",
            show_default=False,
        ),
    ] = None,
    kind: Annotated[
        NoiseKind,
        typer.Option(
            help="gaussian: all vertices along their normals; impulsive: some of them; isotropic: all, in "
            "any direction; kinect1, kinect2, fusion, print: a simulated scan."
        ),
    ] = NoiseKind.GAUSSIAN,
    fraction: Annotated[
        float | None,
        typer.Option(
            min=0.0, max=1.0, help="Fraction of the vertices that impulsive noise moves; 0.3 by default."
        ),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(help="File to write a scan's truth to: the same faces, vertices on the clean surface."),
    ] = None,
    size: Annotated[
        float | None,
        typer.Option(
            help="Metres of the object's bounding-box diagonal before a depth camera; 0.4 by default."
        ),
    ] = None,
    distance: Annotated[
        float | None,
        typer.Option(help="Metres from the camera to the object's middle; 0.8 by default, for kinect2 1.2."),
    ] = None,
    triangulate: TriangulateFlag = False,
    seed: Seed = 0,
) -> None:
    """Add noise to the vertices of IN, or scan it, and write the result to OUT."""
    from gcnd.mesh_io import check_input_path, check_output_path

    check_input_path(input_mesh)
    check_output_path(output_mesh, input_mesh)
    if fraction is not None and kind is not NoiseKind.IMPULSIVE:
        raise ConfigError(f"--fraction does not apply to {kind.value}", hint="it belongs to impulsive")
    if kind in _SCANS:
        if level is not None:
            raise ConfigError(f"--level does not apply to {kind.value}", hint="a scan has its sensor's noise")
        scan = {"seed": seed, "size": size, "distance": distance}
        if kind is NoiseKind.PRINT:
            _print(input_mesh, output_mesh, truth, triangulate, scan)
        else:
            _photograph(input_mesh, output_mesh, truth, _SCANS[kind], scan)
        return
    for option, value in (("--truth", truth), ("--size", size), ("--distance", distance)):
        if value is not None:
            raise ConfigError(
                f"{option} does not apply to {kind.value}",
                hint=f"it belongs to {', '.join(scan.value for scan in _SCANS)}",
            )
    if level is None:
        raise typer.BadParameter(f"{kind.value} noise needs one", param_hint="--level")
    options = {"kind": kind.value, "level": level, "seed": seed}
    if fraction is not None:
        options["fraction"] = fraction
    _add_noise(input_mesh, output_mesh, triangulate, options)


def _add_noise(input_mesh: Path, output_mesh: Path, triangulate: bool, options: dict[str, Any]) -> None:
    from gcnd.data.noise import add_noise
    from gcnd.mesh_io import save, to_arrays
    from gcnd.meshes.arrays import checked
    from gcnd.results import load_source

    arrays, rebuild = to_arrays(load_source(input_mesh, output_mesh, triangulate=triangulate))
    moved = checked(add_noise(arrays.vertices, _oriented(arrays), **options), arrays.faces).vertices
    save(rebuild(moved), output_mesh, like=input_mesh)


def _oriented(arrays: MeshArrays) -> NDArray[np.uint32]:
    """Each face once, turned so that vertex normals do not cancel; what is wrong is told as `gcnd denoise` does."""
    import numpy as np

    from gcnd.surface import as_surface

    once, _ = arrays.welded()
    surface = as_surface(once)
    for sentence in surface.told:
        warnings.warn(sentence, MeshWarning, stacklevel=2)
    rows = slice(None) if surface.place is None else np.unique(surface.place, return_index=True)[1]
    faces = arrays.faces[rows].copy()
    is_turned = (surface.mesh.faces != once.faces[rows]).any(axis=1)
    faces[is_turned] = faces[is_turned][:, [0, 2, 1]]
    return faces


def _print(
    input_mesh: Path, output_mesh: Path, truth: Path | None, triangulate: bool, options: dict[str, Any]
) -> None:
    """Scans a print, whose faces are those of the mesh."""
    from gcnd.mesh_io import save, to_arrays
    from gcnd.results import load_source
    from gcnd.scans.simulate import simulate

    for name in ("size", "distance"):
        if options.pop(name) is not None:
            raise ConfigError(
                f"--{name} does not apply to print", hint="its numbers are in mean edge lengths"
            )
    paths = [output_mesh] if truth is None else [output_mesh, truth]
    if truth is not None:
        _check_truth(input_mesh, output_mesh, truth)
    arrays, rebuild = to_arrays(load_source(input_mesh, *paths, triangulate=triangulate))
    pair = simulate("print", arrays.vertices, _oriented(arrays), **options)
    for path, vertices in zip(paths, (pair.noisy_vertices, pair.clean_vertices), strict=False):
        save(rebuild(vertices), path, like=input_mesh)


def _photograph(
    input_mesh: Path, output_mesh: Path, truth: Path | None, kind: ScanKind, options: dict[str, Any]
) -> None:
    """Takes the mesh with a depth camera, which makes triangles of its own."""
    from gcnd.mesh_io import read_shape, save
    from gcnd.scans.simulate import DEFAULT_SIZE, simulate

    if truth is None:
        raise ConfigError(
            f"{kind} makes faces of its own, and without its truth nothing can be compared with it",
            hint="say where to write the truth: --truth FILE",
        )
    _check_truth(input_mesh, output_mesh, truth)
    arrays = read_shape(input_mesh).arrays
    if options["size"] is None:
        options["size"] = DEFAULT_SIZE
    pair = simulate(kind, arrays.vertices, arrays.faces, **options)
    save((pair.noisy_vertices, pair.faces), output_mesh)
    save((pair.clean_vertices, pair.faces), truth)


def _check_truth(input_mesh: Path, output_mesh: Path, truth: Path) -> None:
    from gcnd.mesh_io import check_output_path

    if os.path.realpath(truth) == os.path.realpath(output_mesh):
        raise ConfigError(f"--truth and OUT are both {truth}", hint="name two files")
    check_output_path(truth, input_mesh, output_mesh)

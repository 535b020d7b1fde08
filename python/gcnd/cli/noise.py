"""`gcnd noise`: a clean mesh made noisy, to test with."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gcnd.cli.options import InputMesh, OutputMesh, Seed
from gcnd.errors import ConfigError

if TYPE_CHECKING:
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
        float, typer.Option(min=0.0, max=1.0, help="Fraction of the vertices that impulsive noise moves.")
    ] = 0.3,
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
    seed: Seed = 0,
) -> None:
    """Add noise to the vertices of IN, or scan it, and write the result to OUT."""
    from gcnd.mesh_io import check_output_path

    check_output_path(output_mesh, input_mesh)
    if kind in _SCANS:
        if level is not None:
            raise ConfigError(f"--level does not apply to {kind.value}", hint="a scan has its sensor's noise")
        _scan(input_mesh, output_mesh, truth, _SCANS[kind], size, distance, seed)
        return
    for option, value in (("--truth", truth), ("--size", size), ("--distance", distance)):
        if value is not None:
            raise ConfigError(
                f"{option} does not apply to {kind.value}",
                hint=f"it belongs to {', '.join(scan.value for scan in _SCANS)}",
            )
    if level is None:
        raise typer.BadParameter(f"{kind.value} noise needs one", param_hint="--level")
    _add_noise(input_mesh, output_mesh, kind, level, fraction, seed)


def _add_noise(
    input_mesh: Path, output_mesh: Path, kind: NoiseKind, level: float, fraction: float, seed: int
) -> None:
    from gcnd.data.noise import add_noise
    from gcnd.mesh_io import load, save, to_arrays

    arrays, rebuild = to_arrays(load(input_mesh))
    moved = add_noise(
        arrays.vertices,
        arrays.faces,
        kind=kind.value,  # type: ignore[arg-type]
        level=level,
        fraction=fraction,
        seed=seed,
    )
    save(rebuild(moved), output_mesh)


def _scan(
    input_mesh: Path,
    output_mesh: Path,
    truth: Path | None,
    kind: ScanKind,
    size: float | None,
    distance: float | None,
    seed: int,
) -> None:
    from gcnd.mesh_io import check_output_path, load, save, to_arrays
    from gcnd.scans.simulate import DEFAULT_SIZE, simulate

    if kind == "print":
        for option, value in (("--size", size), ("--distance", distance)):
            if value is not None:
                raise ConfigError(
                    f"{option} does not apply to print", hint="its numbers are in mean edge lengths"
                )
    elif truth is None:
        raise ConfigError(
            f"{kind} makes faces of its own, and without its truth nothing can be compared with it",
            hint="say where to write the truth: --truth FILE",
        )
    if truth is not None:
        check_output_path(truth, input_mesh)
        if truth.resolve() == output_mesh.resolve():
            raise ConfigError(f"--truth and OUT are both {truth}", hint="name two files")
    arrays, rebuild = to_arrays(load(input_mesh))
    pair = simulate(
        kind,
        arrays.vertices,
        arrays.faces,
        seed=seed,
        size=DEFAULT_SIZE if size is None else size,
        distance=distance,
    )
    if kind == "print":
        save(rebuild(pair.noisy_vertices), output_mesh)
        if truth is not None:
            save(rebuild(pair.clean_vertices), truth)
        return
    save((pair.noisy_vertices, pair.faces), output_mesh)
    if truth is not None:
        save((pair.clean_vertices, pair.faces), truth)

"""One function an entry: draws one case, runs it, and asserts what must hold of every answer.

Each returns whether the input was accepted; what is refused must be refused by the package's own errors. Anything else
that is raised, a panic of the compiled core included, is a failure of the case.
"""

from __future__ import annotations

import warnings
from functools import partial
from pathlib import Path

import numpy as np
from fuzz_checks import Case, Refused
from fuzz_core import (
    averages,
    classes,
    core_filter,
    detail,
    face_geometry,
    measures,
    patches,
    refinement,
    remeshing,
    topology,
    vertex_fit,
    vertex_update,
    weld,
)
from fuzz_files import card_file, log_file, mesh_file, rows_file, weights_file
from fuzz_kernels import KERNELS, kernel
from fuzz_surface import arrays, controls, denoise, info, signs

from gcnd.errors import MeshWarning
from gcnd.filters import list_filters

CASES: dict[str, Case] = {
    "core: topology": topology,
    "core: face geometry": face_geometry,
    "core: weld": weld,
    "core: classes, roughness": classes,
    "core: patches": patches,
    "core: averages, cover": averages,
    "core: refinement": refinement,
    "core: vertex fit": vertex_fit,
    "core: vertex update": vertex_update,
    "core: detail": detail,
    "core: remesh": remeshing,
    **{f"kernel: {name}": partial(kernel, name) for name in KERNELS},
    **{f"filter: {info.name}": partial(core_filter, info.name) for info in list_filters()},
    "metrics": measures,
    "mesh arrays": arrays,
    "controls": controls,
    "mesh info": info,
    "denoise": denoise,
    "signs of a scanner": signs,
    **{f"file: {name[1:]}": partial(mesh_file, name) for name in (".ply", ".obj", ".stl", ".off", ".glb")},
    "file: weights": weights_file,
    "file: model card": card_file,
    "file: training log": log_file,
    "file: comparison rows": rows_file,
}


def run_case(name: str, seed: int, number: int, folder: Path) -> bool:
    """Runs one case, the same one for the same arguments; returns whether its input was accepted."""
    rng = np.random.default_rng([seed, number, *name.encode()])
    with warnings.catch_warnings():
        for kind in (RuntimeWarning, MeshWarning):
            warnings.simplefilter("ignore", kind)
        try:
            return CASES[name](rng, folder)
        except Refused:
            return False


__all__ = ["CASES", "run_case"]

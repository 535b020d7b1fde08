"""MeshLab's smoothing filters by way of pymeshlab, which is under the GPL."""

from __future__ import annotations

from typing import Any

import numpy as np

from gcnd.compare.adapters.base import Adapted, Denoiser, Faces, Library, Setting, Vertices

__all__ = ["LIBRARY"]


def _filter(name: str, settings: dict[str, Setting]) -> Denoiser:
    import pymeshlab

    def denoise(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces]:
        meshes: Any = pymeshlab.MeshSet()
        meshes.add_mesh(pymeshlab.Mesh(vertices, faces.astype(np.int32)))
        meshes.apply_filter(name, **settings)
        result = meshes.current_mesh()
        return result.vertex_matrix(), result.face_matrix().astype(np.uint32)

    return denoise


def two_step(**settings: Setting) -> Denoiser:
    """Makes "two steps smoothing" ready: normals averaged under a threshold angle, then vertices fitted to them."""
    return _filter("apply_coord_two_steps_smoothing", settings)


def taubin(**settings: Setting) -> Denoiser:
    """Makes Taubin smoothing ready; a step is both half-passes."""
    return _filter("apply_coord_taubin_smoothing", settings)


def hc_laplacian() -> Denoiser:
    """Makes HC-Laplacian smoothing ready, which has no parameter."""
    return _filter("apply_coord_hc_laplacian_smoothing", {})


def laplacian(**settings: Setting) -> Denoiser:
    """Makes Laplacian smoothing ready."""
    return _filter("apply_coord_laplacian_smoothing", settings)


_TWO_STEP = {"stepsmoothnum": 3, "normalthr": 60.0, "stepnormalnum": 20, "stepfitnum": 20}
_TWO_STEP_TUNED = {"stepsmoothnum": 1, "normalthr": 90.0, "stepnormalnum": 5, "stepfitnum": 5}
_TAUBIN = {"lambda_": 0.5, "mu": -0.53, "stepsmoothnum": 10}

LIBRARY = Library(
    "pymeshlab",
    "pymeshlab",
    {
        "two-step": Adapted(two_step, _TWO_STEP),
        "two-step-tuned": Adapted(two_step, _TWO_STEP_TUNED),
        "taubin": Adapted(taubin, _TAUBIN),
        "taubin-tuned": Adapted(taubin, {**_TAUBIN, "stepsmoothnum": 30}),
        "hc-laplacian": Adapted(hc_laplacian, {}),
        "laplacian": Adapted(laplacian, {"stepsmoothnum": 3, "boundary": True, "cotangentweight": True}),
    },
)

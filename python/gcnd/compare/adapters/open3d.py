"""Open3D's smoothing of triangle meshes."""

from __future__ import annotations

from typing import Any

import numpy as np

from gcnd.compare.adapters.base import Adapted, Denoiser, Faces, Library, Setting, Vertices

__all__ = ["LIBRARY"]


def _smoother(name: str, settings: dict[str, Setting]) -> Denoiser:
    import open3d

    def denoise(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces]:
        points = open3d.utility.Vector3dVector(vertices)
        mesh: Any = open3d.geometry.TriangleMesh(
            points, open3d.utility.Vector3iVector(faces.astype(np.int32))
        )
        result = getattr(mesh, f"filter_smooth_{name}")(**settings)
        return np.asarray(result.vertices), np.asarray(result.triangles).astype(np.uint32)

    return denoise


def taubin(**settings: Setting) -> Denoiser:
    """Makes Taubin smoothing ready; an iteration is both half-passes."""
    return _smoother("taubin", settings)


def laplacian(**settings: Setting) -> Denoiser:
    """Makes Laplacian smoothing ready, weighted by inverse distance."""
    return _smoother("laplacian", settings)


def simple(**settings: Setting) -> Denoiser:
    """Makes the average of each vertex and its neighbours ready."""
    return _smoother("simple", settings)


_TAUBIN = {"number_of_iterations": 1, "lambda_filter": 0.5, "mu": -0.53}
_LAPLACIAN = {"number_of_iterations": 1, "lambda_filter": 0.5}

LIBRARY = Library(
    "open3d",
    "open3d",
    {
        "taubin": Adapted(taubin, _TAUBIN),
        "taubin-tuned": Adapted(taubin, {**_TAUBIN, "number_of_iterations": 20}),
        "laplacian": Adapted(laplacian, _LAPLACIAN),
        "laplacian-tuned": Adapted(laplacian, {**_LAPLACIAN, "number_of_iterations": 5}),
        "simple": Adapted(simple, {"number_of_iterations": 1}),
        "simple-tuned": Adapted(simple, {"number_of_iterations": 2}),
    },
    hint="on Debian and Ubuntu it needs the package libusb-1.0-0",
)

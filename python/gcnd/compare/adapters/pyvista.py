"""VTK's smoothing filters by way of pyvista."""

from __future__ import annotations

from typing import Any

import numpy as np

from gcnd.compare.adapters.base import Adapted, Denoiser, Faces, Library, Setting, Vertices

__all__ = ["LIBRARY"]


def _smoother(name: str, settings: dict[str, Setting]) -> Denoiser:
    import pyvista

    def denoise(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces]:
        from_faces: Any = pyvista.PolyData.from_regular_faces
        mesh = from_faces(vertices, faces.astype(np.int64))
        result = getattr(mesh, name)(**settings)
        return np.asarray(result.points), np.asarray(result.regular_faces).astype(np.uint32)

    return denoise


def taubin(**settings: Setting) -> Denoiser:
    """Makes windowed-sinc smoothing ready, which VTK has for Taubin's."""
    return _smoother("smooth_taubin", settings)


def laplacian(**settings: Setting) -> Denoiser:
    """Makes Laplacian smoothing ready."""
    return _smoother("smooth", settings)


_EDGES = {
    "edge_angle": 15.0,
    "feature_angle": 45.0,
    "boundary_smoothing": True,
    "feature_smoothing": False,
}
_TAUBIN = {
    "n_iter": 20,
    "pass_band": 0.1,
    **_EDGES,
    "non_manifold_smoothing": False,
    "normalize_coordinates": False,
}
_LAPLACIAN = {"n_iter": 20, "relaxation_factor": 0.01, "convergence": 0.0, **_EDGES}

LIBRARY = Library(
    "pyvista",
    "pyvista",
    {
        "taubin": Adapted(taubin, _TAUBIN),
        "taubin-tuned": Adapted(taubin, {**_TAUBIN, "pass_band": 0.05}),
        "laplacian": Adapted(laplacian, _LAPLACIAN),
        "laplacian-tuned": Adapted(laplacian, {**_LAPLACIAN, "n_iter": 100, "relaxation_factor": 0.03}),
    },
)

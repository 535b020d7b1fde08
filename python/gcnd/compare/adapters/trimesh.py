"""trimesh's smoothing filters."""

from __future__ import annotations

from typing import Any

import numpy as np

from gcnd.compare.adapters.base import Adapted, Denoiser, Faces, Library, Setting, Vertices

__all__ = ["LIBRARY"]


def _smoother(name: str, settings: dict[str, Setting]) -> Denoiser:
    import trimesh

    smooth: Any = getattr(trimesh.smoothing, f"filter_{name}")

    def denoise(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces]:
        mesh = trimesh.Trimesh(vertices.copy(), faces.astype(np.int64), process=False)
        smooth(mesh, **settings)
        return np.asarray(mesh.vertices), np.asarray(mesh.faces).astype(np.uint32)

    return denoise


def humphrey(**settings: Setting) -> Denoiser:
    """Makes Humphrey's filter ready: Laplacian smoothing pushed back (Vollmer et al. 1999)."""
    return _smoother("humphrey", settings)


def taubin(**settings: Setting) -> Denoiser:
    """Makes Taubin smoothing ready; an iteration is one half-pass, shrinking and growing by turns."""
    return _smoother("taubin", settings)


def laplacian(**settings: Setting) -> Denoiser:
    """Makes Laplacian smoothing ready, scaled back to the volume it had."""
    return _smoother("laplacian", settings)


_HUMPHREY = {"alpha": 0.1, "beta": 0.5, "iterations": 10}
_TAUBIN = {"lamb": 0.5, "nu": 0.5, "iterations": 10}
_LAPLACIAN = {
    "lamb": 0.5,
    "iterations": 10,
    "implicit_time_integration": False,
    "volume_constraint": True,
}

LIBRARY = Library(
    "trimesh",
    "trimesh",
    {
        "humphrey": Adapted(humphrey, _HUMPHREY),
        "humphrey-tuned": Adapted(humphrey, {**_HUMPHREY, "iterations": 30}),
        "taubin": Adapted(taubin, _TAUBIN),
        "taubin-tuned": Adapted(taubin, {**_TAUBIN, "iterations": 60}),
        "laplacian": Adapted(laplacian, _LAPLACIAN),
        "laplacian-tuned": Adapted(laplacian, {**_LAPLACIAN, "iterations": 5}),
    },
)

"""MeshLib's denoising of meshes by way of their normals."""

from __future__ import annotations

from typing import Any

import numpy as np

from gcnd.compare.adapters.base import Adapted, Denoiser, Faces, Library, Setting, Vertices

__all__ = ["LIBRARY"]


def denoise(**settings: Setting) -> Denoiser:
    """Makes `meshDenoiseViaNormals` ready: total variation of normals with a crease indicator, then vertices."""
    from meshlib import mrmeshnumpy, mrmeshpy

    def run(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces]:
        mesh: Any = mrmeshnumpy.meshFromFacesVerts(faces.astype(np.int32), vertices)
        options: Any = mrmeshpy.DenoiseViaNormalsSettings()
        for name, value in settings.items():
            setattr(options, name, value)
        mrmeshpy.meshDenoiseViaNormals(mesh, options)
        result = mrmeshnumpy.getNumpyVerts(mesh), mrmeshnumpy.getNumpyFaces(mesh.topology)
        return result[0], result[1].astype(np.uint32)

    return run


_DEFAULTS = {
    "gamma": 5.0,
    "beta": 0.01,
    "guideWeight": 1.0,
    "normalIters": 10,
    "pointIters": 20,
    "fastIndicatorComputation": True,
}

LIBRARY = Library(
    "meshlib",
    "meshlib.mrmeshpy",
    {
        "denoise": Adapted(denoise, _DEFAULTS),
        "denoise-tuned": Adapted(denoise, {**_DEFAULTS, "gamma": 20.0, "beta": 0.03}),
    },
)

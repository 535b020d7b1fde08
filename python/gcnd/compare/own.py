"""gcnd's own methods in the form that the comparison runs: presets of the network and classical filters."""

from __future__ import annotations

from typing import Any

from gcnd.compare.adapters.base import Denoiser, Faces, Vertices

__all__ = ["PRESET_SETTINGS", "filtered", "network"]

PRESET_SETTINGS: dict[str, int | None] = {"seed": 0, "normal_iterations": None, "vertex_iterations": None}
"""What a preset can be given, with defaults; None is what the preset says."""


def network(preset: str, **settings: Any) -> Denoiser:
    """Makes a preset ready: torch imported and the weights read."""
    from gcnd.denoiser import Denoiser as Weights

    weights = Weights(preset, **settings)

    def denoise(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces]:
        return weights.run((vertices, faces)).after, faces

    return denoise


def filtered(method: str, **settings: Any) -> Denoiser:
    """Makes a filter of `gcnd.filters` ready."""
    import trimesh  # noqa: F401  what reads meshes imports it at the first, which is start-up

    from gcnd.filters import apply_filter

    def denoise(vertices: Vertices, faces: Faces) -> tuple[Vertices, Faces]:
        return apply_filter((vertices, faces), method, **settings)[0], faces

    return denoise

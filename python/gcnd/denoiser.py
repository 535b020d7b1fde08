"""Weights held for many meshes, threads and worker processes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from gcnd.controls import Controls
from gcnd.denoise import Boundary, clean_arrays
from gcnd.errors import ConfigError, WeightsError, check_count
from gcnd.predict import fast_precision
from gcnd.runs import Denoised, run_on
from gcnd.weights import load_cascade, weights_hash

if TYPE_CHECKING:
    import numpy as np
    import torch
    from numpy.typing import NDArray

    from gcnd.mesh_io import MeshArrays
    from gcnd.nn.fold import Precision
    from gcnd.stages import Progress, Stages

__all__ = ["Denoiser"]


class Denoiser:
    """Holds loaded weights and settings, for denoising more than one mesh.

    Threads may share one: a run changes nothing in it. Pickled, it is the name or path of the weights and their hash,
    with the settings; who unpickles it reads the weights again and checks that they are the same.

    Args:
        preset: See ``denoise``, as all others but
        controls: How much of the result is wanted; a mask in it fits only meshes with as many vertices.

    Raises:
        ConfigError: A parameter is out of range or the preset is unknown.
        WeightsError: The weights cannot be read or do not fit.

    Example:
        >>> import trimesh
        >>> denoiser = Denoiser("fast")
        >>> balls = [denoiser(trimesh.creation.icosphere(subdivisions=n)) for n in (2, 3)]
        >>> [len(ball.faces) for ball in balls]
        [320, 1280]
    """

    def __init__(
        self,
        preset: str = "default",
        *,
        device: torch.device | str = "cpu",
        seed: int = 0,
        normal_iterations: int | None = None,
        vertex_iterations: int | None = None,
        precision: Precision | None = None,
        boundary: Boundary = "along",
        triangulate: bool = False,
        controls: Controls | None = None,
    ) -> None:
        if boundary not in get_args(Boundary):
            raise ConfigError(f"boundary is {boundary!r}, allowed: {', '.join(get_args(Boundary))}")
        check_count("seed", seed)
        check_count("normal_iterations", normal_iterations)
        check_count("vertex_iterations", vertex_iterations)
        self.preset, self.device, self.controls = str(preset), str(device), controls or Controls()
        self.settings: dict[str, Any] = {
            "seed": seed,
            "normal_iterations": normal_iterations,
            "vertex_iterations": vertex_iterations,
            "precision": precision,
            "boundary": boundary,
        }
        self.triangulate = triangulate
        self.cascade = load_cascade(preset, device)
        self.sha256 = weights_hash(preset)

    def __call__(self, mesh: Any, *, progress: Progress | None = None) -> Any:
        """Denoises one mesh; arguments, result and errors as of ``denoise``."""
        return self.run(mesh, progress=progress).mesh

    def run(
        self, mesh: Any, *, controls: Controls | None = None, progress: Progress | None = None
    ) -> Denoised:
        """Denoises one mesh and returns all that is known of the result.

        Args:
            mesh: See ``denoise``.
            controls: In the place of the denoiser's own.
            progress: See ``denoise``.

        Returns:
            The mesh, the confidence by face, seconds by stage, and a report on request.

        Raises:
            MeshError: The mesh cannot be worked on.
            ConfigError: A control does not fit the mesh.
            Cancelled: ``progress`` returned False.
        """

        def move(mesh: MeshArrays, stages: Stages) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
            cleaned = clean_arrays(
                mesh.vertices, mesh.faces, self.cascade, device=self.device, stages=stages, **self.settings
            )
            return cleaned.vertices, cleaned.confidence

        method = {"preset": self.preset, "sha256": self.sha256, "device": self.device, **self.settings}
        method["precision"] = self.settings["precision"] or fast_precision(self.device)
        return run_on(mesh, move, controls or self.controls, method, progress, self.triangulate)

    def check_confidence(self) -> None:
        """Raises ``ConfigError`` where the weights predict each face once, so that there is nothing to compare."""
        if self.cascade.config.stages[-1].coverage is None:
            raise ConfigError(f"{self.preset} predicts each face once: there is no confidence")

    def __getstate__(self) -> dict[str, Any]:
        state = {name: value for name, value in vars(self).items() if name != "cascade"}
        if self.preset.endswith(".safetensors"):
            state["preset"] = str(Path(self.preset).resolve())
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        found = weights_hash(state["preset"])
        if found != state["sha256"]:
            raise WeightsError(
                f"the weights {state['preset']} have hash {found[:12]}… here and had {state['sha256'][:12]}…",
                hint="give every machine the same weights",
            )
        self.__dict__.update(state)
        self.cascade = load_cascade(self.preset, self.device)

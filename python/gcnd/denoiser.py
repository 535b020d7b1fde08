"""Weights held for many meshes, threads and worker processes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from gcnd import _geom
from gcnd.auto import AUTO, CANDIDATES, choose_preset, read_signs
from gcnd.controls import Controls
from gcnd.denoise import Boundary, clean_arrays
from gcnd.errors import ConfigError, WeightsError, check_count
from gcnd.nn.cascade import MOST_ITERATIONS
from gcnd.nn.fold import Precision
from gcnd.predict import fast_precision
from gcnd.runs import Denoised, Moved, run_on
from gcnd.weights import load_cascade, weights_hash

if TYPE_CHECKING:
    import numpy as np
    import torch
    from numpy.typing import NDArray

    from gcnd.stages import Progress, Stages
    from gcnd.start import Start
    from gcnd.surface import Surface

__all__ = ["Denoiser"]


class Denoiser:
    """Holds loaded weights and settings, for denoising more than one mesh.

    Threads may share one: a run changes nothing in it. Pickled, it is the name or path of the weights and their hash,
    with the settings; who unpickles it reads the weights again and checks that they are the same.

    With preset "auto" the weights of every candidate are held, and each mesh gets those that suit it.

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
        preset: str = AUTO,
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
        if precision is not None and precision not in get_args(Precision):
            raise ConfigError(
                f"precision is {precision!r}, allowed: {', '.join(get_args(Precision))} or None"
            )
        if not isinstance(controls, Controls | None):
            raise ConfigError(f"controls is {controls!r}, allowed: gcnd.Controls or None")
        self.preset, self.device, self.controls = str(preset), str(device), controls or Controls()
        self.settings: dict[str, Any] = {
            "seed": check_count("seed", seed),
            "normal_iterations": check_count("normal_iterations", normal_iterations, MOST_ITERATIONS),
            "vertex_iterations": check_count("vertex_iterations", vertex_iterations, MOST_ITERATIONS),
            "precision": precision,
            "boundary": boundary,
        }
        self.triangulate = triangulate
        names = CANDIDATES if self.preset == AUTO else (self.preset,)
        self.hashes = {name: weights_hash(name, also=(AUTO,)) for name in names}
        self._load()

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
            ConfigError: A control does not fit the mesh, or ``progress`` cannot be called.
            Cancelled: ``progress`` returned False.
        """

        def move(surface: Surface, start: Start, stages: Stages) -> Moved:
            chosen, roughness = self._choose(surface, start, stages)
            cleaned = clean_arrays(
                start,
                surface.topology,
                self.cascades[chosen["preset"]],
                roughness=roughness,
                device=self.device,
                stages=stages,
                **self.settings,
            )
            return Moved(cleaned.vertices, cleaned.confidence, chosen)

        method = {"device": self.device, **self.settings}
        method["precision"] = self.settings["precision"] or fast_precision(self.device)
        return run_on(
            mesh,
            move,
            controls or self.controls,
            method,
            progress,
            self.triangulate,
            takes_spikes_off=True,
        )

    def _choose(
        self, surface: Surface, start: Start, stages: Stages
    ) -> tuple[dict[str, Any], NDArray[np.float64] | None]:
        """The preset for a mesh with what there is to say of it, and the roughness (4,) if it had to be found."""
        if self.preset != AUTO:
            return {"preset": self.preset, "sha256": self.hashes[self.preset]}, None
        stages(0.0, "preset")
        roughness = _geom.mesh_roughness(surface.topology, start.positions)
        signs = read_signs(
            surface.topology, start.positions, surface.mesh.faces, roughness=roughness, ask=stages.ask
        )
        choice = choose_preset(signs)
        return {**choice.described(signs), "sha256": self.hashes[choice.preset]}, roughness

    def check_confidence(self) -> None:
        """Raises ``ConfigError`` where the weights predict each face once, so that there is nothing to compare."""
        if any(cascade.config.stages[-1].coverage is None for cascade in self.cascades.values()):
            raise ConfigError(f"{self.preset} predicts each face once: there is no confidence")

    def _load(self) -> None:
        self.cascades = {name: load_cascade(name, self.device) for name in self.hashes}

    def __getstate__(self) -> dict[str, Any]:
        state = {name: value for name, value in vars(self).items() if name != "cascades"}
        if self.preset.endswith(".safetensors"):
            path = str(Path(self.preset).resolve())
            state |= {"preset": path, "hashes": {path: self.hashes[self.preset]}}
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, expected in state["hashes"].items():
            found = weights_hash(name)
            if found != expected:
                raise WeightsError(
                    f"the weights {name} have hash {found[:12]}… here and had {expected[:12]}…",
                    hint="give every machine the same weights",
                )
        self.__dict__.update(state)
        self._load()

"""Meshes that the earlier stages have denoised: what a later stage of the cascade learns from."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch

from gcnd import _geom
from gcnd.errors import ConfigError
from gcnd.formats.atomic import read_npz, write_atomic_npz
from gcnd.nn.cascade import VERTEX_ITERATIONS
from gcnd.predict import predict_normals
from gcnd.train.samples import NoisyMesh

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray
    from torch import nn

    from gcnd.nn.cascade import StageConfig
    from gcnd.nn.fold import Precision
    from gcnd.train.samples import CleanShape, VertexSource

_STREAM = 0x706F6F6C
"""Keeps the pool's random numbers apart from those of the patches."""


def run_stages(
    mesh: NoisyMesh,
    stages: list[tuple[StageConfig, nn.Module]],
    seed: int,
    device: str = "cpu",
    precision: Precision = "float32",
    vertex_iterations: int = VERTEX_ITERATIONS,
) -> NoisyMesh:
    """Denoises a mesh by every stage in turn: normals, then vertex updating (paper Sec. 5.1)."""
    topology = mesh.shape.topology
    for index, (config, network) in enumerate(stages):
        prediction = predict_normals(
            topology,
            mesh.vertices,
            config,
            network,
            seed=seed + index,
            roughness=mesh.roughness,
            first=mesh.first,
            device=device,
            precision=precision,
        )
        moved = _geom.update_vertices(topology, mesh.vertices, prediction.normals, vertex_iterations)
        mesh = mesh._replace(vertices=moved)
    return mesh


class _Member(NamedTuple):
    shape: int
    vertices: NDArray[np.float32]
    roughness: NDArray[np.float64]
    first: NDArray[np.float32]


class DenoisedPool:
    """A fixed number of noisy meshes, denoised by the earlier stages, kept on disk and drawn from.

    Args:
        folder: Keeps the meshes; made if missing.
        noise: Gives noisy meshes.
        shapes: Every clean mesh that ``noise`` draws.
        stages: The earlier stages, one entry a pass.
        size: How many meshes.
        seed: Of noise and predictions.
        device: Where the stages run.
        precision: Of the stages' products.
        vertex_iterations: Of Eq. 6 after every pass.
        progress: Called with the meshes made and ``size`` after each.
        further: Passes that may follow ``stages``, since a stage that runs several times sees what its own passes made:
            of every ``len(further) + 2`` meshes two have had none, one the first, and so on (docs/choices.md#cascade).
    """

    def __init__(
        self,
        folder: Path,
        noise: VertexSource,
        shapes: list[CleanShape],
        stages: list[tuple[StageConfig, nn.Module]],
        size: int,
        seed: int,
        device: str = "cpu",
        precision: Precision = "float32",
        vertex_iterations: int = VERTEX_ITERATIONS,
        progress: Callable[[int, int], None] | None = None,
        further: Sequence[tuple[StageConfig, nn.Module]] = (),
    ):
        folder.mkdir(parents=True, exist_ok=True)
        self.shapes = shapes
        self.members: list[_Member] = []
        by_identity = {id(shape): index for index, shape in enumerate(shapes)}
        prints = [shape.fingerprint for shape in shapes]
        for number in range(size):
            path = folder / f"{number:04d}.npz"
            member = _load(path, prints)
            if member is None:
                noisy = noise.draw(np.random.default_rng([seed, _STREAM, number]))
                passes = [*stages, *further[: max(0, number % (len(further) + 2) - 1)]]
                denoised = run_stages(noisy, passes, seed + number, device, precision, vertex_iterations)
                index = by_identity[id(noisy.shape)]
                positions = (mesh.vertices.astype(np.float32) for mesh in (denoised, noisy))
                member = _Member(index, next(positions), denoised.roughness, next(positions))
                write_atomic_npz(path, fingerprint=prints[index], **member._asdict())
            self.members.append(member)
            if progress is not None:
                progress(number + 1, size)

    def draw(self, rng: np.random.Generator) -> NoisyMesh:
        """Returns a clean shape with its denoised positions."""
        member = self.members[int(rng.integers(len(self.members)))]
        return NoisyMesh(
            self.shapes[member.shape],
            member.vertices.astype(np.float64),
            member.roughness,
            member.first.astype(np.float64),
        )


def _load(path: Path, prints: list[str]) -> _Member | None:
    """The mesh in a file, or None if there is none or it is damaged."""
    stored = read_npz(path)
    if stored is None:
        return None
    # An earlier version kept no positions from before the first stage.
    index = (
        int(stored["shape"]) if stored.keys() >= {"shape", "fingerprint", *_Member._fields} else len(prints)
    )
    if index < len(prints) and str(stored["fingerprint"]) == prints[index]:
        return _Member(index, stored["vertices"], stored["roughness"], stored["first"])
    raise ConfigError(
        f"{path} was made from other meshes than this run trains on, or by another version",
        hint="give the same meshes again, or another folder",
    )


def evaluation_copy(network: nn.Module, state: dict[str, torch.Tensor]) -> nn.Module:
    """Loads averaged weights into a copy of a network and puts it in evaluation mode."""
    import copy

    twin = copy.deepcopy(network)
    twin.load_state_dict(state)
    return twin.eval()

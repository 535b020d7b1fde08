"""From a mesh and one network to a normal for every face: patches stream through, overlaps are averaged."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch

from gcnd import _geom
from gcnd.nn.cascade import PatchConfig, RefinementConfig, StageConfig
from gcnd.nn.fold import Precision, for_inference

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray
    from torch import nn

PATCH_NODES_IN_FLIGHT = 1 << 14
"""Patch nodes extracted at a time; bounds the memory of prediction whatever the mesh."""


def fast_precision(device: torch.device | str) -> Precision:
    """Returns the fastest precision measured safe on a device.

    bfloat16 on processors that multiply matrices in it: 0.3 to 0.7 of the time, E_a within 0.005°
    (docs/experiments.md);
    float32 elsewhere, CUDA included, where it has not been measured.
    """
    supported = getattr(torch.cpu, "_is_avx512_bf16_supported", None)
    on_cpu = torch.device(device).type == "cpu"
    return "bfloat16" if on_cpu and supported is not None and supported() else "float32"


COVER_STEP, COVER_STEPS = 256, 50
"""A cover looks at the predictions so far after this many patches, and at least this often on a mesh."""


class Prediction(NamedTuple):
    """What a network says of every face.

    Attributes:
        normals: Unit normals (F, 3), world frame; zero only for a face without area that no patch covers.
        spread: How far the overlapping predictions for a face disagree (F,), about radians; 0 for a single one.
    """

    normals: NDArray[np.float64]
    spread: NDArray[np.float64]


class PatchArrays:
    """Buffers for up to ``n_patches`` patches, filled by extraction and reused.

    Attributes:
        features: (P, N, C) float32, patch frame, lengths in patch radii.
        neighbors: (P, N, 3) int32, node ids inside the patch.
        face_ids: (P, N) uint32.
        mask: (P, N) uint8, 0 for a repeat that fills the patch.
        world_from_patch: (P, 3, 3) float64, columns e₁ e₂ e₃.
        radii: (P,) float64, mesh units.
    """

    def __init__(self, n_patches: int, patch: PatchConfig):
        shape = (n_patches, patch.n_nodes)
        self.features = np.empty((*shape, patch.n_channels), dtype=np.float32)
        self.neighbors = np.empty((*shape, 3), dtype=np.int32)
        self.face_ids = np.empty(shape, dtype=np.uint32)
        self.mask = np.empty(shape, dtype=np.uint8)
        self.world_from_patch = np.empty((n_patches, 3, 3), dtype=np.float64)
        self.radii = np.empty(n_patches, dtype=np.float64)

    def head(self, n_patches: int) -> PatchArrays:
        """Returns a view of the first patches."""
        view = object.__new__(PatchArrays)
        for name, array in vars(self).items():
            setattr(view, name, array[:n_patches])
        return view

    def fill(self, extractor: _geom.PatchExtractor, centers: NDArray[np.uint32]) -> None:
        """Extracts the patches around ``centers``, as many as the buffers hold."""
        extractor.extract(
            centers,
            self.features,
            self.neighbors,
            self.face_ids,
            self.mask,
            self.world_from_patch,
            self.radii,
        )


def make_extractor(
    topology: _geom.Topology, vertices: NDArray[np.float64], patch: PatchConfig, seed: int
) -> _geom.PatchExtractor:
    """Prepares patch extraction from a mesh as ``patch`` describes it."""
    return _geom.PatchExtractor(
        topology,
        vertices,
        patch_scale=patch.patch_scale,
        n_nodes=patch.n_nodes,
        budget=patch.budget,
        seed=seed,
        voting_region=patch.voting_region,
        sigma_vote=patch.sigma_vote,
        vertex_offsets=patch.vertex_offsets,
        scale_space=patch.scale_space,
    )


def predict_normals(
    topology: _geom.Topology,
    vertices: NDArray[np.float64],
    stage: StageConfig,
    network: nn.Module,
    *,
    seed: int = 0,
    device: torch.device | str = "cpu",
    precision: Precision = "float32",
    progress: Callable[[float], None] | None = None,
) -> Prediction:
    """Predicts the noise-free normal of every face with one network.

    A network that returns every node's normal runs on patches that cover the mesh as ``stage.coverage`` asks; the
    predictions for a face are averaged with weight exp(−2‖c̄‖²), c̄ its centroid in the patch's frame and radii. A
    network that returns the centre's normal runs once a face.

    Args:
        topology: Adjacency of the mesh.
        vertices: Positions (V, 3), mesh units.
        stage: How to cut patches, and how many.
        network: Maps (P, N, C) features and (P, N, 3) neighbours to (P, N, 3) or (P, 3) normals.
        seed: Chooses the patch centres.
        device: Where the network's weights are.
        precision: Of the network's linear layers and of what passes between them.
        progress: Called with the fraction done.

    Returns:
        Normals and their spread.

    Paper: Sec. 5. Choice: docs/choices.md#cover.
    """
    extractor = make_extractor(topology, vertices, stage.patch, seed)
    accumulator = _geom.NormalAccumulator(topology.n_faces)
    per_node = stage.network.architecture == "nodes"
    batch = max(1, PATCH_NODES_IN_FLIGHT // stage.patch.n_nodes)
    buffers = PatchArrays(min(batch, topology.n_faces), stage.patch)
    predict = partial(_predict, for_inference(network.eval(), precision), torch.device(device))
    chunks = (
        _chunks(topology.n_faces, batch)
        if stage.coverage is None
        else _cover(accumulator, topology.n_faces, stage.coverage, seed)
    )
    for done, chosen in chunks:
        for _, part in _chunks(len(chosen), batch):
            centers = chosen[part]
            _add_chunk(extractor, accumulator, buffers.head(len(centers)), centers, predict, per_node)
        if progress is not None:
            progress(done)
    return Prediction(accumulator.normals(extractor.normals()), accumulator.spread())


def refined(
    topology: _geom.Topology,
    vertices: NDArray[np.float64],
    prediction: Prediction,
    refinement: RefinementConfig,
) -> NDArray[np.float64]:
    """Refines predicted normals (F, 3) by Eq. 5, everywhere or where the spread of the predictions allows it.

    Paper: Sec. 6.1. Choice: docs/choices.md#refinement.
    """
    m, sigma_r = refinement.iterations, refinement.sigma_r
    if refinement.tolerance is None:
        return _geom.refine_normals(topology, vertices, prediction.normals, iterations=m, sigma_r=sigma_r)
    spread = np.minimum(prediction.spread, refinement.largest_spread or np.inf)
    return _geom.refine_consistent(
        topology,
        vertices,
        prediction.normals,
        spread,
        iterations=m,
        sigma_r=sigma_r,
        tolerance=refinement.tolerance,
    )


@torch.inference_mode()
def _predict(network: nn.Module, device: torch.device, patches: PatchArrays) -> NDArray[np.float32]:
    features = torch.from_numpy(patches.features).to(device)
    neighbors = torch.from_numpy(patches.neighbors).to(device)
    predicted: torch.Tensor = network(features, neighbors)
    return predicted.cpu().numpy()


def _add_chunk(
    extractor: _geom.PatchExtractor,
    accumulator: _geom.NormalAccumulator,
    patches: PatchArrays,
    centers: NDArray[np.uint32],
    predict: Callable[[PatchArrays], NDArray[np.float32]],
    per_node: bool,
) -> None:
    patches.fill(extractor, centers)
    predicted = predict(patches)
    if per_node:
        accumulator.add_nodes(
            patches.features, patches.face_ids, patches.mask, patches.world_from_patch, predicted
        )
    else:
        accumulator.add_centers(centers, patches.world_from_patch, predicted)


def _chunks(n_faces: int, size: int) -> Iterator[tuple[float, NDArray[np.uint32]]]:
    """Yields (fraction done after this chunk, face ids), every face once."""
    for start in range(0, n_faces, size):
        stop = min(start + size, n_faces)
        yield stop / n_faces, np.arange(start, stop, dtype=np.uint32)


def _cover(
    accumulator: _geom.NormalAccumulator, n_faces: int, coverage: float, seed: int
) -> Iterator[tuple[float, NDArray[np.uint32]]]:
    """Yields (fraction of the faces looked at, centres), each time where predictions are still missing."""
    cover = _geom.Cover(n_faces, coverage, seed)
    # Patches chosen at once do not see each other: few at a time on a small mesh.
    at_most = max(1, min(COVER_STEP, n_faces // COVER_STEPS))
    while len(centers := cover.next_centers(accumulator, at_most)):
        yield cover.progress, centers

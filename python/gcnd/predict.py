"""From a mesh and one network to a normal for every face: patches stream through, overlaps are averaged."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier, Lock
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch

from gcnd import _geom
from gcnd.flat import is_flat
from gcnd.memory import nodes_that_fit
from gcnd.neighbors import sum_across_edges
from gcnd.nn.cascade import PatchConfig, RefinementConfig, StageConfig
from gcnd.nn.fold import Precision, for_inference

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray
    from torch import nn

PATCH_NODES_A_BATCH = {"cpu": 1 << 12, "cuda": 1 << 16}
"""Patch nodes that go through the network at a time, on the CPU in each thread; for "cuda" not measured."""


def fast_precision(device: torch.device | str) -> Precision:
    """Returns the fastest precision measured safe on a device.

    bfloat16 on processors that multiply matrices in it: 0.3 to 0.7 of the time, E_a within 0.005°
    (docs/experiments.md);
    float32 elsewhere, CUDA included, where it has not been measured.
    """
    supported = getattr(torch.cpu, "_is_avx512_bf16_supported", None)
    on_cpu = torch.device(device).type == "cpu"
    return "bfloat16" if on_cpu and supported is not None and supported() else "float32"


COVER_STEP, COVER_SHARE = 256, 50
"""A cover looks at the predictions so far after this many patches, on a small mesh after a fiftieth of its faces."""

EVERY_FACE_STEP = 4096
"""Faces at a time where every face has a patch: bounds memory."""

_STARTING = Lock()
"""Held while the threads of a prediction start."""

_SINGLE = 1e-6
"""Spread in radians up to which there was one prediction; two never agree so well, and one leaves rounding."""


class Prediction(NamedTuple):
    """What a network says of every face.

    Attributes:
        normals: Unit normals (F, 3), world frame; zero only for a face without area that no patch covers.
        spread: How far the overlapping predictions for a face disagree (F,), about radians; 0 for a single one.
    """

    normals: NDArray[np.float64]
    spread: NDArray[np.float64]


class PatchArrays:
    """Buffers for ``n_patches`` patches, filled by extraction.

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
    topology: _geom.Topology,
    vertices: NDArray[np.float64],
    patch: PatchConfig,
    seed: int,
    roughness: NDArray[np.float64] | None = None,
    first: NDArray[np.float64] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> _geom.PatchExtractor:
    """Prepares patch extraction from a mesh as ``patch`` describes it; ``roughness`` and ``first`` as of
    `predict_normals`.

    ``progress`` is called after each step with (step, steps in all); what it raises stops the preparation.
    """
    if first is None:
        first = vertices
    if patch.roughness and roughness is None:
        roughness = _geom.mesh_roughness(topology, vertices)
    return _geom.PatchExtractor(
        topology,
        vertices,
        patch_scale=patch.patch_scale,
        sheets=patch.sheets,
        n_nodes=patch.n_nodes,
        budget=patch.budget,
        seed=seed,
        voting_region=patch.voting_region,
        sigma_vote=patch.sigma_vote,
        vertex_offsets=patch.vertex_offsets,
        scale_space=patch.scale_space,
        first=first if patch.first_normals else None,
        roughness=roughness if patch.roughness else None,
        progress=progress,
    )


def predict_normals(
    topology: _geom.Topology,
    vertices: NDArray[np.float64],
    stage: StageConfig,
    network: nn.Module,
    *,
    seed: int = 0,
    roughness: NDArray[np.float64] | None = None,
    first: NDArray[np.float64] | None = None,
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
        roughness: Of the mesh before its first pass (4,), as ``_geom.mesh_roughness`` gives it; ``None`` takes that of
            ``vertices``.
        first: Positions before the mesh's first pass (V, 3), mesh units; ``None`` takes ``vertices``.
        device: Where the network's weights are.
        precision: Of the network's linear layers and of what passes between them.
        progress: Called with the fraction done, while patches are prepared and after every batch of them; what it
            raises ends the prediction and its threads.

    Returns:
        Normals and their spread.

    Paper: Sec. 5. Choice: docs/choices.md#cover.
    """

    def prepared(_: int, __: int) -> None:
        if progress is not None:
            progress(0.0)

    extractor = make_extractor(topology, vertices, stage.patch, seed, roughness, first, prepared)
    accumulator = _geom.NormalAccumulator(topology.n_faces)
    chosen = (
        _every_face(topology.n_faces)
        if stage.coverage is None
        else _cover(accumulator, topology.n_faces, stage.coverage, seed)
    )
    with PatchPredictor(
        extractor, for_inference(network.eval(), precision), stage, torch.device(device)
    ) as predictor:
        fraction = 0.0
        for done, centers in chosen:
            for prediction in predictor.predict(centers):
                _add(accumulator, prediction, stage)
                # After every batch, so that who wants to stop need not wait for the whole step.
                if progress is not None:
                    progress(fraction)
            fraction = done
    if progress is not None:
        progress(1.0)
    return Prediction(accumulator.normals(extractor.normals()), accumulator.spread())


def agreement(topology: _geom.Topology, spread: NDArray[np.float64]) -> NDArray[np.float64]:
    """Says how far the overlapping predictions around each face agree.

    c_f = 1 − s̄_f/√2, s̄_f the mean spread over f and the faces across its edges that have more than one prediction.

    Args:
        topology: Adjacency of the mesh.
        spread: Of the predictions for each face (F,), as ``Prediction`` has it.

    Returns:
        (F,), 1 where all agree; 0 where there are no two predictions to compare.

    Choice: docs/choices.md#confidence.
    """
    is_compared = (spread > _SINGLE).astype(np.float64)
    total = is_compared * spread
    total = total + sum_across_edges(topology, total)
    count = is_compared + sum_across_edges(topology, is_compared)
    mean = np.divide(total, count, out=np.full(topology.n_faces, np.sqrt(2.0)), where=count > 0)
    confidence: NDArray[np.float64] = np.clip(1.0 - mean / np.sqrt(2.0), 0.0, 1.0)
    return confidence


def refined(
    topology: _geom.Topology,
    vertices: NDArray[np.float64],
    prediction: Prediction,
    refinement: RefinementConfig,
    progress: Callable[[int, int], None] | None = None,
) -> NDArray[np.float64]:
    """Refines predicted normals (F, 3) by Eq. 5, everywhere or where the spread of the predictions allows it, and on
    flat meshes only where ``refinement`` says so.

    ``progress`` is called after each step with (step, steps in all); what it raises stops the refinement.

    Paper: Sec. 6.1. Choice: docs/choices.md#refinement.
    """
    if refinement.flat_only and not is_flat(topology, vertices):
        return prediction.normals
    m, sigma_r = refinement.iterations, refinement.sigma_r
    if refinement.tolerance is None:
        return _geom.refine_normals(
            topology, vertices, prediction.normals, iterations=m, sigma_r=sigma_r, progress=progress
        )
    spread = np.minimum(prediction.spread, refinement.largest_spread or np.inf)
    return _geom.refine_consistent(
        topology,
        vertices,
        prediction.normals,
        spread,
        iterations=m,
        sigma_r=sigma_r,
        tolerance=refinement.tolerance,
        progress=progress,
    )


class PatchPrediction(NamedTuple):
    """What a network says of the patches around ``centers``: (P, N, 3) or (P, 3) normals in the patch frames."""

    centers: NDArray[np.uint32]
    patches: PatchArrays
    normals: NDArray[np.float32]


class PatchPredictor:
    """Cuts patches and runs a network on them, on the CPU in as many threads as torch has.

    Every thread takes batches of its own through the linear layers, so that nobody waits for others between layers
    and small batches stay in the caches; extraction and the native kernels share rayon's threads. Where memory is
    short, batches are smaller, here by what is free and elsewhere by trying.
    """

    def __init__(
        self,
        extractor: _geom.PatchExtractor,
        network: nn.Module,
        stage: StageConfig,
        device: torch.device,
    ):
        self.extractor, self.network, self.patch, self.device = extractor, network, stage.patch, device
        nodes, n_nodes = PATCH_NODES_A_BATCH[device.type], stage.patch.n_nodes
        if device.type == "cpu":
            nodes = nodes_that_fit(nodes, n_nodes, stage.network.bytes_a_node, torch.get_num_threads())
        self.batch = max(1, nodes // n_nodes)
        self.pool = _single_threads() if device.type == "cpu" else ThreadPoolExecutor(1)

    def __enter__(self) -> PatchPredictor:
        return self

    def __exit__(self, *_: object) -> None:
        self.pool.shutdown(cancel_futures=True)

    def predict(self, centers: NDArray[np.uint32]) -> Iterator[PatchPrediction]:
        """Starts on all patches around ``centers`` and returns their predictions in order, a batch at a time."""
        starts = range(0, len(centers), self.batch)
        return self.pool.map(self._one_batch, [centers[i : i + self.batch] for i in starts])

    @torch.inference_mode()
    def _one_batch(self, centers: NDArray[np.uint32]) -> PatchPrediction:
        patches = PatchArrays(len(centers), self.patch)
        patches.fill(self.extractor, centers)
        features, neighbors = torch.from_numpy(patches.features), torch.from_numpy(patches.neighbors)
        return PatchPrediction(centers, patches, self._predicted(features, neighbors).numpy())

    def _predicted(self, features: torch.Tensor, neighbors: torch.Tensor) -> torch.Tensor:
        """Runs the network; where the device has no memory for so many patches, on half of them at a time."""
        try:
            normals: torch.Tensor = self.network(features.to(self.device), neighbors.to(self.device))
            return normals.cpu()
        except torch.OutOfMemoryError:
            if len(features) == 1:
                raise
        middle = len(features) // 2
        parts = (slice(None, middle), slice(middle, None))
        return torch.cat([self._predicted(features[part], neighbors[part]) for part in parts])


def settle_threads() -> None:
    """Gives the calling thread torch's number of threads for good, before its first use of torch.

    A thread takes it over from whoever set it last, and while another run starts its workers that is one.
    """
    with _STARTING:
        torch.get_num_threads()


def _one_thread() -> None:
    # A thread takes the process's number over when torch is first used in it, here and not after the next line.
    torch.get_num_threads()
    torch.set_num_threads(1)


def _single_threads() -> ThreadPoolExecutor:
    """Starts threads in which torch's operations run on one thread each, as many as torch has; elsewhere they run on
    as many as before."""
    # One caller at a time: a thread new to torch would take over the one thread that another's workers set.
    with _STARTING:
        n_threads = torch.get_num_threads()
        ready = Barrier(n_threads + 1)
        pool = ThreadPoolExecutor(n_threads, initializer=_one_thread)
        try:
            for _ in range(n_threads):
                pool.submit(ready.wait)
            ready.wait()
        except BaseException:
            # Ctrl-C: nobody else would free those that wait, and the process would never end.
            ready.abort()
            pool.shutdown(cancel_futures=True)
            raise
        finally:
            # The setting is a thread's own, but threads that have none yet take it over from whoever set it last.
            torch.set_num_threads(n_threads)
    return pool


def _add(accumulator: _geom.NormalAccumulator, prediction: PatchPrediction, stage: StageConfig) -> None:
    centers, patches, normals = prediction
    if stage.network.predicts_nodes:
        accumulator.add_nodes(
            patches.features, patches.face_ids, patches.mask, patches.world_from_patch, normals
        )
    else:
        accumulator.add_centers(centers, patches.world_from_patch, normals)


def _every_face(n_faces: int) -> Iterator[tuple[float, NDArray[np.uint32]]]:
    """Yields (fraction done after these, face ids), every face once."""
    for start in range(0, n_faces, EVERY_FACE_STEP):
        stop = min(start + EVERY_FACE_STEP, n_faces)
        yield stop / n_faces, np.arange(start, stop, dtype=np.uint32)


def _cover(
    accumulator: _geom.NormalAccumulator, n_faces: int, coverage: float, seed: int
) -> Iterator[tuple[float, NDArray[np.uint32]]]:
    """Yields (fraction of the faces looked at, centres), each time where predictions are still missing."""
    cover = _geom.Cover(n_faces, coverage, seed)
    # Patches chosen at once do not see each other: few at a time on a small mesh.
    at_most = max(1, min(COVER_STEP, n_faces // COVER_SHARE))
    while len(centers := cover.next_centers(accumulator, at_most)):
        yield cover.progress, centers

"""Scans to train on: drawn anew from clean meshes, a pure function of (seed, number), kept on disk."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from gcnd.data.noise import FaceArray, FloatArray
from gcnd.errors import ConfigError, MeshError
from gcnd.formats.atomic import read_npz, write_atomic_npz
from gcnd.scans.fusion import Fusion
from gcnd.scans.grid import Diagonal
from gcnd.scans.kinect1 import Kinect1
from gcnd.scans.kinect2 import Kinect2
from gcnd.scans.printed import Print
from gcnd.scans.simulate import SCAN_KINDS, ScanKind, Setting, simulate

PAIRS_VERSION = 2
"""Raise when a seed gives other pairs: older files are then made again."""

KIND_SHARES = (0.3, 0.3, 0.25, 0.15)
"""How often each kind is drawn, in the order of ``SCAN_KINDS``."""

FEWEST_FACES = 2000
"""A depth camera's pair of fewer faces, an object seen from its thin side, is drawn again."""

CROPPED_SHARE = (0.3, 0.8)
"""Of its faces, what `cropped` leaves of a scan."""

_ATTEMPTS = 10
_STEPS_PER_PIXEL = (8.0, 8.0, 16.0, 32.0)
_DIAGONALS: tuple[Diagonal, ...] = ("down", "up", "shorter")


class CleanMesh(Protocol):
    """A mesh that scans are made of."""

    name: str
    vertices: FloatArray
    faces: FaceArray


class TrainingPair(NamedTuple):
    """A simulated scan with its truth.

    Attributes:
        name: Of the clean mesh, the kind and the number.
        kind: One of `gcnd.scans.SCAN_KINDS`.
        clean_vertices: (V, 3) float64, the truth, in the unit of the clean mesh.
        noisy_vertices: (V, 3) float64.
        faces: (F, 3) uint32, of both.
    """

    name: str
    kind: ScanKind
    clean_vertices: FloatArray
    noisy_vertices: FloatArray
    faces: FaceArray


@dataclass(frozen=True)
class ScanDraw:
    """What is drawn for one pair; see `simulate` for the fields."""

    size: float
    distance: float
    setting: Setting
    diagonal: Diagonal


def draw_scan(kind: ScanKind, rng: np.random.Generator) -> ScanDraw:
    """Draws how an object is scanned, as widely as people do it; docs/scans.md has the ranges.

    The size of the object's image is drawn, and not its own: it sets how many faces a frame has.
    """
    diagonal = _DIAGONALS[int(rng.integers(len(_DIAGONALS)))]
    if kind == "kinect1":
        distance = float(rng.uniform(0.65, 1.2))
        return ScanDraw(distance * float(rng.uniform(0.3, 0.52)), distance, _kinect1(rng), diagonal)
    if kind == "kinect2":
        distance = float(rng.uniform(0.85, 1.5))
        sensor = Kinect2(
            noise=float(rng.uniform(0.6, 1.1)),
            window=float(rng.uniform(0.6, 1.2)),
            least_albedo=float(rng.uniform(0.35, 1.0)),
        )
        return ScanDraw(distance * float(rng.uniform(0.4, 0.75)), distance, sensor, diagonal)
    if kind == "fusion":
        distance = float(rng.uniform(0.75, 1.1))
        size = float(rng.uniform(0.3, 0.55))
        fusion = Fusion(
            sensor=_kinect1(rng),
            n_frames=int(rng.integers(8, 17)),
            voxel=size / float(rng.uniform(75, 115)),
            turn_error=float(np.deg2rad(rng.uniform(0.05, 0.4))),
            shift_error=float(rng.uniform(0.0002, 0.002)),
        )
        return ScanDraw(size, distance, fusion, diagonal)
    printed = Print(
        blur_rounds=int(rng.integers(0, 3)),
        layer=float(rng.uniform(3.0, 8.0)),
        relief=float(rng.uniform(0.03, 0.2)),
        warp=float(rng.uniform(0.0, 0.6)),
        noise=float(rng.uniform(0.02, 0.12)),
        noise_rounds=int(rng.integers(0, 3)),
    )
    return ScanDraw(0.4, 0.8, printed, diagonal)


def _kinect1(rng: np.random.Generator) -> Kinect1:
    """Finer steps than the sensor's own stand for programs that average frames or filter depth."""
    return Kinect1(
        noise=float(rng.uniform(0.5, 1.1)),
        window=float(rng.uniform(1.5, 3.0)),
        steps_per_pixel=_STEPS_PER_PIXEL[int(rng.integers(len(_STEPS_PER_PIXEL)))],
    )


@dataclass(frozen=True)
class _Job:
    """One pair to make: all that another process needs to know, and what tells its file from others."""

    name: str
    vertices: FloatArray
    faces: FaceArray
    kind: ScanKind
    seed: int
    number: int

    def path(self, folder: Path) -> Path:
        return folder / f"scan-v{PAIRS_VERSION}-{self.seed:08d}-{self.number:06d}.npz"

    def fingerprint(self) -> str:
        """Tells the clean mesh and the kind from any other."""
        arrays = (self.vertices, self.faces)
        content = b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)
        return hashlib.sha256(content + self.kind.encode()).hexdigest()


def training_pair(
    meshes: Sequence[CleanMesh], seed: int, number: int, kind: ScanKind | None = None
) -> TrainingPair:
    """Makes pair ``number`` of the endless list that ``seed`` starts: the same for ever.

    Args:
        meshes: Clean meshes; one is drawn, all alike.
        seed: Of the list, >= 0.
        number: Place in the list, >= 0.
        kind: One of `SCAN_KINDS`; None draws it as `KIND_SHARES` says.

    Returns:
        The pair.

    Raises:
        ConfigError: No mesh, or a negative seed or number.
        MeshError: Ten scans in turn had fewer than `FEWEST_FACES` faces.
        GcndError: A fused scan without scikit-image.

    Choice: docs/choices.md#simulated-scans.

    Example:
        >>> import trimesh
        >>> from gcnd.data.shapes import Shape
        >>> ball = trimesh.creation.icosphere(subdivisions=3)
        >>> shape = Shape("ball", "smooth", np.array(ball.vertices), ball.faces.astype(np.uint32))
        >>> training_pair([shape], seed=0, number=7, kind="kinect2").name
        'ball-kinect2-7'
    """
    return _make(_job(meshes, seed, number, kind))


def cropped(pair: TrainingPair, seed: int) -> TrainingPair:
    """Cuts a scan off around one of its faces, so that it also ends where it does not turn away from the camera.

    Frames end at silhouettes, and a network that has seen no other rims expects every surface to bend away there. What
    is left are the faces nearest to a drawn one, between `CROPPED_SHARE` of them and at least `FEWEST_FACES`, by their
    centroids in the truth.

    Args:
        pair: A scan and its truth.
        seed: Of what is drawn, >= 0.

    Returns:
        A pair of fewer faces, and of the vertices that they use.

    Choice: docs/choices.md#simulated-scans.
    """
    rng = np.random.default_rng(seed)
    n_kept = max(round(len(pair.faces) * float(rng.uniform(*CROPPED_SHARE))), FEWEST_FACES)
    if n_kept >= len(pair.faces):
        return pair
    centroids = pair.clean_vertices[pair.faces].mean(axis=1)
    distances = np.linalg.norm(centroids - centroids[int(rng.integers(len(centroids)))], axis=1)
    nearest = np.sort(np.argsort(distances, kind="stable")[:n_kept])
    used, faces = np.unique(pair.faces[nearest], return_inverse=True)
    return pair._replace(
        clean_vertices=pair.clean_vertices[used],
        noisy_vertices=pair.noisy_vertices[used],
        faces=faces.reshape(-1, 3).astype(np.uint32),
    )


def load_training_pairs(
    meshes: Sequence[CleanMesh],
    n: int,
    seed: int,
    folder: Path | str,
    *,
    kinds: Sequence[ScanKind | None] = (None,),
    workers: int = 2,
    progress: Callable[[int, int], None] | None = None,
) -> list[TrainingPair]:
    """Returns the first ``n`` pairs of a list, from disk where they are and made and stored where they are not.

    Args:
        meshes: Clean meshes. A file that was made from another one is made again.
        n: How many, >= 0.
        seed: Of the list, >= 0.
        folder: Where the ``.npz`` files lie; made if missing.
        kinds: Kind of each pair, in turn; None draws it.
        workers: Processes that make what is missing; 1 works in this process.
        progress: Called with the pairs made and those to make after each.

    Returns:
        The pairs in order.

    Raises:
        ConfigError: A negative count or seed, fewer than one worker, or no mesh.
        MeshError: As for `training_pair`.
        GcndError: A fused scan without scikit-image.
    """
    if n < 0 or workers < 1:
        message = f"cannot load {n} scans with {workers} workers"
        raise ConfigError(message, hint="n must be >= 0 and workers >= 1")
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    jobs = [_job(meshes, seed, number, kinds[number % len(kinds)]) for number in range(n)]
    missing = [job for job in jobs if _read(place, job) is None]
    for made, _ in enumerate(_make_all(missing, place, workers), start=1):
        if progress is not None:
            progress(made, len(missing))
    return [_read(place, job) or _made_and_stored(job, place) for job in jobs]


def _job(meshes: Sequence[CleanMesh], seed: int, number: int, kind: ScanKind | None) -> _Job:
    if not meshes:
        raise ConfigError("there is no clean mesh to scan")
    if seed < 0 or number < 0:
        raise ConfigError(f"scan {number} of seed {seed}", hint="use integers >= 0")
    rng = np.random.default_rng([seed, number])
    mesh = meshes[int(rng.integers(len(meshes)))]
    drawn = SCAN_KINDS[int(rng.choice(len(SCAN_KINDS), p=KIND_SHARES))]
    return _Job(mesh.name, mesh.vertices, mesh.faces, kind or drawn, seed, number)


def _make(job: _Job) -> TrainingPair:
    failed: MeshError | None = None
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([job.seed, job.number, SCAN_KINDS.index(job.kind), attempt])
        draw = draw_scan(job.kind, rng)
        try:
            pair = simulate(
                job.kind,
                job.vertices,
                job.faces,
                seed=int(rng.integers(2**31)),
                size=draw.size,
                distance=draw.distance,
                setting=draw.setting,
                diagonal=draw.diagonal,
            )
        except MeshError as error:  # from another side, or closer, it may be a scan
            failed = error
            continue
        if job.kind == "print" or len(pair.faces) >= FEWEST_FACES:
            name = f"{job.name}-{job.kind}-{job.number}"
            return TrainingPair(name, job.kind, pair.clean_vertices, pair.noisy_vertices, pair.faces)
    raise MeshError(
        f"{_ATTEMPTS} {job.kind} scans of {job.name} "
        + ("" if failed is None else "failed or ")
        + f"had fewer than {FEWEST_FACES} faces"
        + ("" if failed is None else f", one of them: {failed}"),
        hint="leave this mesh out of the training",
    ) from failed


def _make_all(jobs: Sequence[_Job], folder: Path, workers: int) -> Iterator[None]:
    """Makes and stores every pair, and yields after each."""
    if workers == 1 or len(jobs) < 2:
        for job in jobs:
            _store_only(job, folder)
            yield
        return
    # A fork would copy locks held by threads of the parent, such as torch's.
    with ProcessPoolExecutor(min(workers, len(jobs)), mp_context=get_context("spawn")) as pool:
        for future in [pool.submit(_store_only, job, folder) for job in jobs]:
            future.result()
            yield


def _store_only(job: _Job, folder: Path) -> None:
    _made_and_stored(job, folder)


def _made_and_stored(job: _Job, folder: Path) -> TrainingPair:
    pair = _make(job)
    write_atomic_npz(job.path(folder), **pair._asdict(), fingerprint=job.fingerprint())
    return pair


def _read(folder: Path, job: _Job) -> TrainingPair | None:
    """The pair in a job's file, or None if there is none, it is damaged, or it was made of something else."""
    names = ("clean_vertices", "noisy_vertices", "faces")
    stored = read_npz(job.path(folder), "fingerprint", "name", *names)
    if stored is None or str(stored["fingerprint"]) != job.fingerprint():
        return None
    return TrainingPair(str(stored["name"]), job.kind, *(stored[name] for name in names))

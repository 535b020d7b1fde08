"""What a comparison denoises: generated shapes, clean meshes with noise added, or pairs of noisy and clean files."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast

import numpy as np

from gcnd.compare.rows import printable
from gcnd.compare.summary import ALL
from gcnd.data.folders import find_meshes
from gcnd.data.generated import load_generated
from gcnd.data.noise import NOISE_KINDS, FaceArray, FloatArray, NoiseKind, add_noise
from gcnd.data.pairs import PairFiles, Split, list_pairs, load_pair
from gcnd.errors import ConfigError, MeshError
from gcnd.mesh_io import load, to_arrays
from gcnd.scans import SCAN_KINDS, ScanKind, simulate

__all__ = ["BUILTIN", "FIRST_SHAPE_SEED", "Case", "CaseMesh", "NoisePlan", "collect_cases", "holds_pairs"]

BUILTIN = "builtin"
"""The name that stands for generated shapes in the place of a folder."""

FIRST_SHAPE_SEED = 1_000_100
"""Seed of the first generated shape: none that weights were trained or validated on."""

SCAN_LEVEL = "scan"
"""What stands in the place of a level where the scanner says how noisy a mesh is."""

_PAIR_PARTS = ("noisy", "original")


@dataclass(frozen=True)
class CaseMesh:
    """Holds what every method of a case is given, and the truth.

    Attributes:
        noisy: Positions (V, 3), mesh units.
        truth: Positions (V, 3), mesh units.
        faces: Vertex ids (F, 3) of both.
    """

    noisy: FloatArray
    truth: FloatArray
    faces: FaceArray

    @property
    def digest(self) -> str:
        """Hash of the arrays: two cases with one hash are the same."""
        whole = hashlib.sha256()
        for array in (self.noisy, self.truth, self.faces):
            whole.update(np.ascontiguousarray(array).tobytes())
        return whole.hexdigest()[:16]


@dataclass(frozen=True)
class Case:
    """Names one noisy mesh.

    Attributes:
        mesh: Name of the clean mesh.
        kind: "cad", "smooth" or "feature"; other folders' names, or "mesh", where files have none.
        noise: Kind of noise, or of scan; "given" for pairs.
        level: Of the noise, as text: mean edge lengths, `SCAN_LEVEL`, or what a pair's file is called after its mesh.
        load: Reads or makes the arrays; the same at each call. Raises ``GcndError`` where that cannot be done.
    """

    mesh: str
    kind: str
    noise: str
    level: str
    load: Callable[[], CaseMesh] = field(compare=False, repr=False)


@dataclass(frozen=True)
class NoisePlan:
    """Says which noise clean meshes are given: every kind at every level, and of every kind of scan one.

    Attributes:
        kinds: Of `gcnd.data.noise` and `gcnd.scans`.
        levels: Of noise, in mean edge lengths; a scan is one as the scanner makes it.
        fraction: Of the vertices that impulsive noise moves.
        seed: Of the noise and the scans.
    """

    kinds: tuple[str, ...] = ("gaussian",)
    levels: tuple[float, ...] = (0.1, 0.2, 0.3)
    fraction: float = 0.3
    seed: int = 0

    def __post_init__(self) -> None:
        """Checks every value.

        Raises:
            ConfigError: An unknown kind, a level or a fraction out of range, or nothing to do.
        """
        known = (*NOISE_KINDS, *SCAN_KINDS)
        unknown = [kind for kind in self.kinds if kind not in known]
        if unknown or not self.kinds:
            hint = f"kinds are {', '.join(known)}"
            raise ConfigError(f"unknown noise {unknown[0]!r}" if unknown else "no noise is named", hint)
        bad = [level for level in self.levels if not 0 <= level <= 10]
        if bad or not self.levels:
            message = f"noise level is {bad[0]:g}, allowed: 0 to 10" if bad else "no noise level is given"
            raise ConfigError(message, hint="levels are in mean edge lengths, such as 0.1,0.2,0.3")
        if not 0 <= self.fraction <= 1:
            raise ConfigError(f"fraction is {self.fraction:g}, allowed: 0 to 1")


def collect_cases(
    dataset: str, plan: NoisePlan, *, n_shapes: int = 12, shape_folder: Path, split: str = "test"
) -> list[Case]:
    """Finds or makes what is to be denoised.

    Every mesh is read and checked here, so that a comparison does not find out at its end that none can be used.
    Of one that cannot, beside others that can, ``load`` raises what is wrong with it.

    Args:
        dataset: `BUILTIN`; a folder with ``noisy`` and ``original``, or with these in a folder for each half, which
            holds pairs; or a folder of clean meshes at any depth.
        plan: Noise for meshes that have none; pairs bring their own.
        n_shapes: Generated shapes of `BUILTIN`.
        shape_folder: Keeps generated shapes.
        split: Half of a dataset of pairs, "train" or "test".

    Returns:
        The cases, mesh by mesh.

    Raises:
        ConfigError: The folder is missing or holds no mesh, or a noisy mesh has no truth.
        MeshError: No file can be read, or every noisy mesh and its truth differ in faces.
        GcndError: What generates shapes is not installed.

    Example:
        >>> collect_cases("dataset", NoisePlan(), shape_folder=Path("shapes"))[0].level  # doctest: +SKIP
        '0.1'
    """
    if dataset == BUILTIN:
        return _generated(n_shapes, plan, shape_folder)
    folder = Path(dataset)
    if not folder.is_dir():
        what = f"{folder} is a file, not a folder" if folder.exists() else f"no such folder: {folder}"
        raise ConfigError(what, hint=f"give a folder of meshes or of pairs, or {BUILTIN}")
    if _holds_pairs(folder):
        return _paired(list_pairs(folder.resolve().parent, cast(Split, folder.resolve().name)))
    if any(_holds_pairs(folder / half) for half in ("test", "train")):
        return _paired(list_pairs(folder, cast(Split, split)))
    return _clean(folder, plan)


def holds_pairs(folder: Path) -> bool:
    """Whether a folder holds pairs, which bring their own noise."""
    return any(_holds_pairs(path) for path in (folder, folder / "test", folder / "train"))


def _holds_pairs(folder: Path) -> bool:
    return all((folder / part).is_dir() for part in _PAIR_PARTS)


def _paired(pairs: Sequence[PairFiles]) -> list[Case]:
    cases, failed = [], []
    for pair in pairs:
        try:
            load_pair(pair)
        except MeshError as error:
            failed.append(error)
        level = _apart(pair.noisy.stem.removeprefix(pair.clean.stem).lstrip("_") or "noisy")

        def read(pair: PairFiles = pair) -> CaseMesh:
            return CaseMesh(*load_pair(pair))

        cases.append(Case(printable(pair.clean.stem), "mesh", "given", level, read))
    for case, number in Counter((case.mesh, case.level) for case in cases).items():
        if number > 1:
            message = f"{number} noisy meshes are called {case[0]}, {case[1]}"
            raise ConfigError(message, hint="give files that differ only after the dot other names")
    if len(failed) == len(pairs):
        raise failed[0]
    return cases


def _clean(folder: Path, plan: NoisePlan) -> list[Case]:
    cases, failed = [], []
    paths = find_meshes(folder)
    stems = Counter(path.with_suffix("") for path in paths)
    for path in paths:
        kind = "mesh" if path.parent == folder else _apart(path.parent.name)
        short = path.with_suffix("")
        name = printable((short if stems[short] == 1 else path).relative_to(folder).as_posix())
        try:
            mesh, _ = to_arrays(load(path))[0].welded()
        except MeshError as error:
            failed.append(error)
            nothing = np.empty((0, 3)), np.empty((0, 3), np.uint32)
            cases += [replace(case, load=_raising(error)) for case in _noisy(name, kind, *nothing, plan)]
        else:
            cases += _noisy(name, kind, mesh.vertices, mesh.faces, plan)
    if len(failed) == len(paths):
        raise failed[0]
    return cases


def _raising(error: MeshError) -> Callable[[], CaseMesh]:
    def load() -> CaseMesh:
        raise error

    return load


def _apart(name: str) -> str:
    """A file's or a folder's name, in quotes where the tables have it for the mean over all."""
    return f"'{name}'" if name == ALL else printable(name)


def _generated(n: int, plan: NoisePlan, folder: Path) -> list[Case]:
    if n < 1:
        raise ConfigError(f"the number of shapes is {n}, allowed: 1 or more")
    hint = "pip install 'gcnd[compare]', or give a folder of meshes"
    shapes = load_generated(n, FIRST_SHAPE_SEED, folder, hint=hint)
    return [case for s in shapes for case in _noisy(s.name, s.kind, s.vertices, s.faces, plan)]


def _noisy(name: str, kind: str, truth: FloatArray, faces: FaceArray, plan: NoisePlan) -> list[Case]:
    cases = []
    for noise in plan.kinds:
        if noise in SCAN_KINDS:

            def scan(noise: str = noise) -> CaseMesh:
                return CaseMesh(*simulate(cast(ScanKind, noise), truth, faces, seed=plan.seed))

            cases.append(Case(name, kind, noise, SCAN_LEVEL, scan))
            continue
        for level in plan.levels:

            def make(noise: str = noise, level: float = level) -> CaseMesh:
                noisy = add_noise(
                    truth,
                    faces,
                    kind=cast(NoiseKind, noise),
                    level=level,
                    fraction=plan.fraction,
                    seed=plan.seed,
                )
                return CaseMesh(noisy, truth, faces)

            short = f"{level:g}"
            cases.append(Case(name, kind, noise, short if float(short) == level else repr(level), make))
    return cases

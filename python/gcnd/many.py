"""Many meshes, one after the other: what is done is skipped, what fails does not stop the rest."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeAlias

from gcnd.data.folders import mesh_files, real_path
from gcnd.errors import Cancelled, ConfigError, GcndError, check_progress
from gcnd.formats.atomic import write_hint
from gcnd.mesh_io import SUPPORTED, check_output_path
from gcnd.results import check_confidence_path, load_source, write_denoised
from gcnd.runs import Denoised, Method
from gcnd.stages import Progress

__all__ = [
    "Job",
    "Outcome",
    "Tell",
    "Wanted",
    "denoise_many",
    "mesh_files",
    "run_job",
]

Folder: TypeAlias = "str | os.PathLike[str]"


@dataclass(frozen=True, eq=False)
class Outcome:
    """Says what became of one mesh of many.

    Attributes:
        name: Of the file, relative to the folder where one was given; of a mesh, its place in the list.
        status: "done", "skipped" for a result that was there already, or "failed".
        seconds: Wall-clock seconds, reading and writing included.
        error: Why it failed, or None.
        output: The file that was written or was there, or None.
        denoised: What was found; None where it was written to a file, so that meshes do not pile up in memory.
        report: What ran and what it changed, where asked for.
        preset: Whose weights ran; None for a filter.
        warnings: What is wrong with the mesh, in sentences.
    """

    name: str
    status: Literal["done", "skipped", "failed"]
    seconds: float = 0.0
    error: Exception | None = None
    output: Path | None = None
    denoised: Denoised | None = None
    report: dict[str, Any] | None = None
    preset: str | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Job:
    """One mesh to work on, where its result goes, and its share of the whole."""

    name: str
    mesh: Any
    output: Path | None
    weight: float


Tell: TypeAlias = Callable[[Outcome], object]
"""Takes what became of a mesh."""


def _tell_nobody(outcome: Outcome) -> None:
    """Leaves it to what is returned."""


class Wanted(NamedTuple):
    """What is wanted of every mesh; see ``denoise_many``."""

    confidence: bool = False
    reports: bool = False


def denoise_many(
    meshes: Folder | Iterable[Any],
    output: Folder | None = None,
    *,
    denoiser: Method | None = None,
    overwrite: bool = False,
    confidence: bool = False,
    reports: bool = False,
    ray: bool = False,
    progress: Progress | None = None,
    tell: Tell = _tell_nobody,
) -> list[Outcome]:
    """Denoises many meshes, one after the other or on a Ray cluster, and says of each what became of it.

    A mesh that fails does not stop the others. With an output folder, a result that is there and not older than its
    input is skipped, so that a stopped run goes on where it was; results are written whole or not at all.

    Args:
        meshes: A folder, searched with its subfolders for files that gcnd reads; or paths and meshes, as ``denoise``
            takes them.
        output: Folder for the results, under the names of the inputs; made where missing. Needed for a folder; only for
            paths.
        denoiser: What runs: a ``Denoiser``, by default with preset "auto", or a ``gcnd.filters.Filter``; with its
            ``triangulate``, faces of more than three corners are split for the work, in files written whole again.
        overwrite: Whether to work again on what is done.
        confidence: Whether files get the confidence by face as an attribute; only PLY can hold it.
        reports: Whether outcomes have a report.
        ray: Whether to work on a Ray cluster, several at a time; see ``gcnd.cluster``; progress is by whole meshes.
        progress: Called with (fraction of all, the name at work and its number); returning False cancels all.
        tell: Called with each outcome as soon as it is known, so that of a stopped run they are not lost.

    Returns:
        One outcome a mesh, in order.

    Raises:
        ConfigError: There is nothing to do, two results would have one name, a result would replace an input, a mesh
            that is no file has an output, or ``progress`` cannot be called.
        Cancelled: ``progress`` returned False; results so far are kept.

    Example:
        >>> import trimesh
        >>> balls = [trimesh.creation.icosphere(subdivisions=2), ([[0, 0, 0]], [])]
        >>> [outcome.status for outcome in denoise_many(balls)]
        ['done', 'failed']
    """
    check_progress(progress)
    jobs = _jobs(meshes, None if output is None else Path(output))
    wanted = Wanted(confidence, reports)
    if denoiser is None:
        from gcnd.denoiser import Denoiser

        denoiser = Denoiser()
    skipped = [
        Outcome(job.name, "skipped", output=job.output)
        if not overwrite and is_done(job.mesh, job.output)
        else None
        for job in jobs
    ]
    if not ray:
        return _one_by_one(jobs, skipped, denoiser, wanted, progress, tell)
    from gcnd.cluster import run_on_ray

    for outcome in filter(None, skipped):
        tell(outcome)
    left = [job for job, outcome in zip(jobs, skipped, strict=True) if outcome is None]
    done = iter(run_on_ray(left, denoiser, wanted, progress, tell))
    return [outcome or next(done) for outcome in skipped]


def _one_by_one(
    jobs: Sequence[Job],
    skipped: Sequence[Outcome | None],
    denoiser: Method,
    wanted: Wanted,
    progress: Progress | None,
    tell: Tell,
) -> list[Outcome]:
    whole, past = sum(job.weight for job in jobs), 0.0
    outcomes: list[Outcome] = []
    for number, job in enumerate(jobs):
        label = f"{job.name} ({number + 1} of {len(jobs)})"

        def told(fraction: float, _: str, past: float = past, job: Job = job, label: str = label) -> object:
            if progress is None:
                return None
            return progress((past + fraction * job.weight) / whole, label)

        outcomes.append(skipped[number] or run_job(job, denoiser, wanted, told))
        tell(outcomes[-1])
        past += job.weight
    if progress is not None:
        progress(1.0, "done")
    return outcomes


def _jobs(meshes: Folder | Iterable[Any], output: Path | None) -> list[Job]:
    if isinstance(meshes, str | os.PathLike):
        folder = Path(meshes)
        if output is None:
            raise ConfigError("a folder of meshes needs a folder for the results", "pass output")
        if not folder.is_dir():
            raise ConfigError(f"no such folder: {folder}", "for one mesh, use denoise")
        if real_path(folder) == real_path(output):
            raise ConfigError(
                f"{output} is the input itself", "choose another folder; the input is never changed"
            )
        files = mesh_files(folder, output)
        jobs = [_file_job(path.relative_to(folder).as_posix(), path, output) for path in files]
        hint = f"gcnd reads {', '.join(SUPPORTED)}"
    else:
        jobs = []
        for index, mesh in enumerate(meshes):
            if isinstance(mesh, str | os.PathLike):
                jobs.append(_file_job(Path(mesh).name if output else str(mesh), Path(mesh), output))
            elif output is None:
                jobs.append(Job(f"mesh {index}", mesh, None, 1.0))
            else:
                raise ConfigError(f"mesh {index} is no file: its result has no name", "leave output out")
        hint = None
    if not jobs:
        raise ConfigError("there is no mesh to denoise", hint)
    names = Counter(job.name for job in jobs)
    twice = next((name for name, count in names.items() if count > 1), None) if output else None
    if twice is not None:
        raise ConfigError(
            f"two results would be written to {twice}", "pass a folder, or rename one of the inputs"
        )
    _check_no_input_is_replaced(jobs)
    return jobs


def _check_no_input_is_replaced(jobs: Sequence[Job]) -> None:
    """Raises ``ConfigError`` where a result has the place of any input, as through a link or folders in each other."""
    inputs = {_identity(job.mesh): job.mesh for job in jobs if job.output and os.path.isfile(job.mesh)}
    for job in jobs:
        replaced = inputs.get(_identity(job.output)) if job.output and job.output.exists() else None
        if replaced is not None:
            raise ConfigError(
                f"{job.output}, where the result of {job.mesh} goes, is the input {replaced}",
                "choose another folder; the input is never changed",
            )


def _identity(path: Folder) -> tuple[int, int]:
    """What a file has under all of its names."""
    found = os.stat(path)
    return found.st_dev, found.st_ino


def _file_job(name: str, path: Path, output: Path | None) -> Job:
    # The bar goes by size: what a folder holds differs by orders of magnitude.
    size = path.stat().st_size if path.is_file() else 0
    return Job(name, path, None if output is None else output / name, float(max(size, 1)))


def is_done(mesh: Any, output: Path | None) -> bool:
    """Says whether a result is there and not older than the file it was made from."""
    if output is None or not output.is_file() or not os.path.isfile(mesh):
        return False
    return output.stat().st_mtime_ns >= os.stat(mesh).st_mtime_ns


def run_job(job: Job, denoiser: Method, wanted: Wanted, progress: Progress) -> Outcome:
    """Works on one mesh, as ``denoise_many`` says; what is wrong with it is told in the outcome."""
    started = time.perf_counter()
    try:
        if job.output is None:
            done = denoiser.run(job.mesh, progress=progress)
            return _done(job, started, done, wanted, denoised=done)
        if wanted.confidence:
            check_confidence_path(job.output)
        _make_folder(job.output.parent)
        check_output_path(job.output, job.mesh)
        mesh = load_source(
            job.mesh, job.output, triangulate=denoiser.triangulate, confidence=wanted.confidence
        )
        done = denoiser.run(mesh, progress=progress)
        write_denoised(done, job.output, source=job.mesh, confidence=wanted.confidence)
        return _done(job, started, done, wanted, output=job.output)
    except Cancelled:
        raise
    except (
        Exception
    ) as error:  # whatever is wrong with one mesh is told in its outcome and must not stop the rest
        return Outcome(job.name, "failed", time.perf_counter() - started, error=error)


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise GcndError(
            f"cannot make the folder {folder}: {error.strerror or error}", write_hint(error)
        ) from error


def _done(job: Job, started: float, done: Denoised, wanted: Wanted, **result: Any) -> Outcome:
    return Outcome(
        job.name,
        "done",
        time.perf_counter() - started,
        report=done.report() if wanted.reports else None,
        warnings=done.warnings,
        preset=done.method.get("preset"),
        **result,
    )

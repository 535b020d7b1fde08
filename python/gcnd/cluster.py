"""Many meshes on the machines of a Ray cluster; a mesh whose worker dies is worked on again by another."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Any

from gcnd.errors import Cancelled, ConfigError, GcndError
from gcnd.many import Job, Outcome, Tell, Wanted, run_job
from gcnd.runs import Method
from gcnd.stages import Progress, stops

__all__ = ["run_on_ray"]

MAX_RETRIES = 3
"""How often a mesh is begun again after its worker died."""

_ENDING = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


def run_on_ray(
    jobs: Sequence[Job], denoiser: Method, wanted: Wanted, progress: Progress | None, tell: Tell
) -> list[Outcome]:
    """Runs each job as a task of one CPU on a Ray cluster: the one this process is connected to, or a local one.

    A cluster that is started here ends with the run, however that ends; one that was there is left as it is.

    Args:
        jobs: What to do; their files must be reachable from every machine under the same names.
        denoiser: Travels to the workers by pickle.
        wanted: Of every mesh.
        progress: See ``denoise_many``; told of meshes that are done.
        tell: Called with each outcome as soon as it is known, in any order.

    Returns:
        The outcomes, in order. One whose worker died more than `MAX_RETRIES` times has failed.

    Raises:
        ConfigError: Ray is not installed.
        Cancelled: ``progress`` returned False; no further mesh is begun.
    """
    try:
        import ray
    except ImportError:
        raise ConfigError("ray is not installed", "pip install 'gcnd[ray]'") from None
    with _connected(ray):
        return _spread(ray, jobs, denoiser, wanted, progress, tell)


@contextmanager
def _connected(ray: Any) -> Iterator[None]:
    """Starts a cluster, or connects to the one that ``RAY_ADDRESS`` names, and ends at the end what was begun here.

    Without that, a program that leaves at once on a signal would leave some of the processes that Ray started.
    """
    if ray.is_initialized():
        yield
        return
    try:
        with _signals_wait():
            ray.init(log_to_driver=False, include_dashboard=False)
        yield
    finally:
        with _signals_wait():
            # Ends processes that init has started; a cluster that init has only connected to goes on.
            ray.shutdown()


@contextmanager
def _signals_wait() -> Iterator[None]:
    """Obeys signals at the end of the block, which calls Ray.

    Ray stopped while it starts or ends processes loses sight of them, and of what a handler raises in its other calls.
    Ctrl-C, and of SIGTERM and SIGHUP those that have a handler, whose place Ray's own, which leaves in the middle of
    all, does not take.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    noticed: list[int] = []

    def handle(number: int, frame: FrameType | None) -> None:
        noticed.append(number)

    def set_other(signalnum: int, handler: Any) -> Any:
        return handle if signalnum in previous else set_handler(signalnum, handler)

    set_handler = signal.signal
    previous: dict[int, Any] = {n: h for n in _ENDING if callable(h := signal.getsignal(n))}
    previous[signal.SIGINT] = signal.getsignal(signal.SIGINT)
    try:
        for number in previous:
            set_handler(number, handle)
        signal.signal = set_other
        yield
    finally:
        signal.signal = set_handler
        for number, handler in previous.items():
            # None stands for a handler that was not set from Python, and cannot be set again.
            set_handler(number, signal.default_int_handler if handler is None else handler)
        for number in noticed[:1]:
            signal.raise_signal(number)


def _spread(
    ray: Any,
    jobs: Sequence[Job],
    denoiser: Method,
    wanted: Wanted,
    progress: Progress | None,
    tell: Tell,
) -> list[Outcome]:
    """The outcomes of the jobs, which work at once as far as the cluster has CPUs."""
    work: Any = ray.remote(num_cpus=1, max_retries=MAX_RETRIES)(_work)
    index_of: dict[Any, int] = {}
    outcomes: dict[int, Outcome] = {}
    whole, past = sum(job.weight for job in jobs), 0.0
    try:
        with _signals_wait():
            shared = ray.put(denoiser)
            index_of.update({work.remote(job, shared, wanted): i for i, job in enumerate(jobs)})
        for index, outcome in _as_they_end(ray, index_of, jobs):
            if outcome is not None:
                outcomes[index] = outcome
                past += jobs[index].weight
                tell(outcome)
            told = f"{len(outcomes)} of {len(jobs)} done"
            if progress is not None and stops(progress(past / whole, told)):
                raise Cancelled("cancelled")
    except BaseException:
        # On a cluster that goes on, they would go on too.
        with _signals_wait():
            for task, index in index_of.items():
                if index not in outcomes:
                    ray.cancel(task)
        raise
    return [outcomes[index] for index in range(len(jobs))]


def _as_they_end(
    ray: Any, index_of: Mapping[Any, int], jobs: Sequence[Job]
) -> Iterator[tuple[int, Outcome | None]]:
    """Yields the outcome of each task as it ends, with its job's index; (-1, None) ten times a second meanwhile."""
    waiting = list(index_of)
    while waiting:
        with _signals_wait():
            ready, waiting = ray.wait(waiting, timeout=0.1)
        if not ready:
            yield -1, None
        for task in ready:
            index = index_of[task]
            try:
                with _signals_wait():
                    outcome = ray.get(task)
            except ray.exceptions.RayError as error:
                failure = GcndError(f"its worker was lost: {type(error).__name__}")
                outcome = Outcome(jobs[index].name, "failed", error=failure)
            yield index, outcome


def _work(job: Job, denoiser: Method, wanted: Wanted) -> Outcome:
    return run_job(job, denoiser, wanted, lambda fraction, stage: None)

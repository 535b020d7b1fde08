"""Many meshes on the machines of a Ray cluster; a mesh whose worker dies is worked on again by another."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from gcnd.errors import Cancelled, ConfigError, GcndError
from gcnd.many import Job, Outcome, Tell, Wanted, run_job
from gcnd.runs import Method
from gcnd.stages import Progress, stops

__all__ = ["run_on_ray"]

MAX_RETRIES = 3
"""How often a mesh is begun again after its worker died."""


def run_on_ray(
    jobs: Sequence[Job], denoiser: Method, wanted: Wanted, progress: Progress | None, tell: Tell
) -> list[Outcome]:
    """Runs each job as a task of one CPU on a Ray cluster: the one this process is connected to, or a local one.

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
    if not ray.is_initialized():
        ray.init(log_to_driver=False, include_dashboard=False)
    work: Any = ray.remote(num_cpus=1, max_retries=MAX_RETRIES)(_work)
    shared = ray.put(denoiser)
    index_of = {work.remote(job, shared, wanted): i for i, job in enumerate(jobs)}
    waiting, whole, past = list(index_of), sum(job.weight for job in jobs), 0.0
    outcomes: dict[int, Outcome] = {}
    while waiting:
        ready, waiting = ray.wait(waiting, timeout=0.1)
        for task in ready:
            index = index_of[task]
            past += jobs[index].weight
            try:
                outcomes[index] = ray.get(task)
            except ray.exceptions.RayError as error:
                failure = GcndError(f"its worker was lost: {type(error).__name__}")
                outcomes[index] = Outcome(jobs[index].name, "failed", error=failure)
            tell(outcomes[index])
        told = f"{len(outcomes)} of {len(jobs)} done"
        if progress is not None and stops(progress(past / whole, told)):
            for task in waiting:
                ray.cancel(task)
            raise Cancelled("cancelled")
    return [outcomes[index] for index in range(len(jobs))]


def _work(job: Job, denoiser: Method, wanted: Wanted) -> Outcome:
    return run_job(job, denoiser, wanted, lambda fraction, stage: None)

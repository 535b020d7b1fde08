"""How far a run has come: told to whoever asked, who can stop it, and timed stage by stage."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from gcnd.errors import Cancelled, check_progress

__all__ = ["Progress", "Stages", "stops"]

Progress: TypeAlias = Callable[[float, str], object]
"""Takes the fraction done, in [0, 1], and the stage at work; returning False stops the run."""


def stops(answer: object) -> bool:
    """Whether what a callback answered stops the run.

    Not every falsy value does: tqdm's update and its like return None or counts.

    Example:
        >>> stops(False), stops(None), stops(0)
        (True, False, False)
    """
    return isinstance(answer, bool | np.bool_) and not answer


class Stages:
    """Tells a callback how far a run has come, stops the run when it answers False, and times the stages.

    Args:
        progress: Called with (fraction done, stage). ``False`` stops the run; ``None``, ``True`` and anything else, as
            the counts that progress bars return, go on.

    Raises:
        ConfigError: ``progress`` cannot be called.

    Attributes:
        seconds: Wall-clock seconds by stage, in the order in which they began; of the stage at work, up to the last
            call.

    Example:
        >>> stages = Stages(lambda fraction, stage: fraction < 0.5)
        >>> stages(0.0, "normals")
        >>> stages(0.5, "normals")
        Traceback (most recent call last):
        gcnd.errors.Cancelled: cancelled at 50 %, normals
    """

    def __init__(self, progress: Progress | None = None) -> None:
        check_progress(progress)
        self.seconds: dict[str, float] = {}
        self._progress = progress
        self._stage: str | None = None
        self._fraction = 0.0
        self._since = time.perf_counter()

    def __call__(self, fraction: float, stage: str) -> None:
        """Notes the stage and tells the callback; raises ``Cancelled`` when that answers False."""
        now = time.perf_counter()
        if self._stage is not None:
            self.seconds[self._stage] += now - self._since
        self._stage, self._fraction, self._since = stage, fraction, now
        self.seconds.setdefault(stage, 0.0)
        answer = None if self._progress is None else self._progress(fraction, stage)
        if stops(answer):
            raise Cancelled(f"cancelled at {fraction:.0%}".replace("%", " %") + f", {stage}")

    def ask(self, *_: object) -> None:
        """Asks once more, in the middle of a stage; takes what the core says of its own progress and leaves it.

        Raises:
            Cancelled: The callback answers False.
        """
        if self._stage is not None:
            self(self._fraction, self._stage)

"""What a run on Ray begins and ends, with a stand-in for Ray that works in the process itself."""

from __future__ import annotations

import os
import signal
import types
from typing import Any

import numpy as np
import pytest

from cli_cases import FACES, VERTICES, stand_in
from gcnd import denoise_many
from gcnd.errors import Cancelled
from gcnd.filters import Filter

PAIR = (VERTICES, FACES)


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is asked of Ray, in order; ``init`` makes it initialised."""
    asked: list[str] = []

    def remote(**options: Any) -> Any:
        return lambda work: types.SimpleNamespace(remote=lambda *arguments: _Task(work, arguments))

    stand_in(
        monkeypatch,
        "ray",
        is_initialized=lambda: asked[-1:] == ["init"],
        init=lambda **options: asked.append("init"),
        shutdown=lambda: asked.append("shutdown"),
        put=lambda value: value,
        get=lambda task: task.work(*task.arguments),
        wait=lambda tasks, timeout: (tasks[:1], tasks[1:]),
        cancel=lambda task: asked.append("cancel"),
        remote=remote,
        exceptions=types.SimpleNamespace(RayError=ConnectionError),
    )
    return asked


class _Task:
    def __init__(self, work: Any, arguments: Any) -> None:
        self.work, self.arguments = work, arguments


def test_a_cluster_that_is_started_ends_with_the_run(calls: list[str]) -> None:
    (outcome,) = denoise_many([PAIR], denoiser=Filter("taubin"), ray=True)
    assert outcome.denoised is not None
    assert np.array_equal(outcome.denoised.after, Filter("taubin").run(PAIR).after)
    assert calls == ["init", "shutdown"]


def test_a_cluster_that_was_there_is_left_alone(calls: list[str]) -> None:
    calls.append("init")
    (outcome,) = denoise_many([PAIR], denoiser=Filter("taubin"), ray=True)
    assert outcome.status == "done"
    assert calls == ["init"]


def test_a_cancelled_run_ends_it(calls: list[str]) -> None:
    told: list[str] = []
    with pytest.raises(Cancelled):
        denoise_many(
            [PAIR, PAIR],
            denoiser=Filter("taubin"),
            ray=True,
            progress=lambda *_: False,
            tell=lambda outcome: told.append(outcome.status),
        )
    assert calls == ["init", "cancel", "shutdown"]
    assert told == ["done"]


def test_on_a_cluster_that_was_there_nothing_goes_on_after_an_error(calls: list[str]) -> None:
    def progress(fraction: float, stage: str) -> None:
        raise ZeroDivisionError

    calls.append("init")
    with pytest.raises(ZeroDivisionError):
        denoise_many([PAIR, PAIR, PAIR], denoiser=Filter("taubin"), ray=True, progress=progress)
    assert calls == ["init", "cancel", "cancel"]


@pytest.mark.skipif(os.name == "nt", reason="signals of another kind")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
@pytest.mark.parametrize("moment", ["init", "wait", "shutdown"])
def test_a_signal_with_a_handler_ends_it_at_any_moment(
    calls: list[str], monkeypatch: pytest.MonkeyPatch, moment: str, name: str
) -> None:
    import ray

    class Ended(BaseException):
        """Raised by our handler."""

    def ours(*_: object) -> None:
        raise Ended

    def rays(*_: object) -> None:
        raise SystemExit

    def interrupted(*arguments: Any, **options: Any) -> Any:
        if moment == "init":  # as Ray does there
            signal.signal(signal.SIGTERM, rays)
        signal.raise_signal(number)
        return real(*arguments, **options)

    number, real = getattr(signal, name), getattr(ray, moment)
    monkeypatch.setattr(ray, moment, interrupted)
    before = {each: signal.signal(each, ours) for each in (signal.SIGTERM, signal.SIGHUP)}
    try:
        with pytest.raises(Ended):
            denoise_many([PAIR], denoiser=Filter("taubin"), ray=True)
        assert signal.getsignal(number) is ours
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
    assert calls == (["init", "cancel", "shutdown"] if moment == "wait" else ["init", "shutdown"])


@pytest.mark.parametrize("moment", ["init", "wait", "shutdown"])
def test_ctrl_c_ends_it_at_any_moment(calls: list[str], monkeypatch: pytest.MonkeyPatch, moment: str) -> None:
    import ray

    real = getattr(ray, moment)

    def interrupted(*arguments: Any, **options: Any) -> Any:
        signal.raise_signal(signal.SIGINT)
        return real(*arguments, **options)

    monkeypatch.setattr(ray, moment, interrupted)
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        denoise_many([PAIR], denoiser=Filter("taubin"), ray=True)
    # What has not been heard of yet is taken back.
    assert calls == (["init", "cancel", "shutdown"] if moment == "wait" else ["init", "shutdown"])
    assert signal.getsignal(signal.SIGINT) is before

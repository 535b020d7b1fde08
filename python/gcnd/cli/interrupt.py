"""Ctrl-C and other signals that end a program: noticed even where a library swallows them, and obeyed without waiting
for libraries to be unloaded.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import NoReturn

__all__ = [
    "EXIT_INTERRUPTED",
    "EXIT_SIGNAL",
    "Ended",
    "check_interrupted",
    "exit_now",
    "nothing_to_lose",
    "noticing_ctrl_c",
    "own_process",
    "tidying_up",
]

EXIT_SIGNAL = 128
"""Plus a signal's number: the exit code of what that signal ended, as shells have it."""

EXIT_INTERRUPTED = EXIT_SIGNAL + 2

_ENDING = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]

_interrupted = threading.Event()
_owns_process = threading.Event()
_ended_by: list[int] = []


class Ended(BaseException):
    """Says that a signal other than Ctrl-C's asks the process to end, as `kill` and a terminal that is closed send it.

    Args:
        number: Of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.exit_code = EXIT_SIGNAL + number


@contextmanager
def noticing_ctrl_c() -> Iterator[None]:
    """Remembers Ctrl-C while the block runs, besides raising ``KeyboardInterrupt``.

    Libraries that try imports under ``except BaseException`` swallow the exception; `check_interrupted` raises it
    again.
    """
    _interrupted.clear()
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def handle(number: int, frame: FrameType | None) -> None:
        _interrupted.set()
        signal.default_int_handler(number, frame)

    previous = signal.signal(signal.SIGINT, handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)


@contextmanager
def nothing_to_lose() -> Iterator[None]:
    """Lets Ctrl-C end the process at once while the block runs, as before any work: importing torch holds it for long.

    Only in a process of the command line's own; who calls `main` from a program of theirs gets ``KeyboardInterrupt``.
    """
    if not _owns_process.is_set():
        yield
        return
    check_interrupted()
    previous = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)


@contextmanager
def tidying_up() -> Iterator[None]:
    """Lets SIGTERM, and SIGHUP where there is one, raise `Ended` while the block runs, so that nothing is left behind.

    The first of them alone does: a second must not stop the tidying. Only in a process of the command line's own, and
    what is ignored, as under `nohup`, stays so.
    """
    taken = [n for n in _ENDING if _owns_process.is_set() and signal.getsignal(n) is signal.SIG_DFL]
    _ended_by.clear()

    def handle(number: int, frame: FrameType | None) -> None:
        for each in taken:
            signal.signal(each, signal.SIG_IGN)
        _ended_by.append(number)
        raise Ended(number)

    for number in taken:
        signal.signal(number, handle)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)


def own_process() -> None:
    """Says that the process is the command line's own; to be called from its main thread."""
    _owns_process.set()


def check_interrupted() -> None:
    """Raises ``KeyboardInterrupt`` if Ctrl-C came since `noticing_ctrl_c` began, and `Ended` as `tidying_up` does."""
    if _ended_by:
        raise Ended(_ended_by[0])
    if _interrupted.is_set():
        raise KeyboardInterrupt


def exit_now(code: int) -> NoReturn:
    """Ends the process at once, output flushed; torch needs a second and more to be unloaded in the usual way."""
    for stream in (sys.stdout, sys.stderr):
        # A reader that has gone is no reason to stay.
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)

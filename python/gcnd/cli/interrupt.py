"""Ctrl-C: noticed even where a library swallows it, and obeyed without waiting for libraries to be unloaded."""

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
    "check_interrupted",
    "exit_now",
    "nothing_to_lose",
    "noticing_ctrl_c",
    "own_process",
]

EXIT_INTERRUPTED = 130

_interrupted = threading.Event()
_owns_process = threading.Event()


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


def own_process() -> None:
    """Says that the process is the command line's own; to be called from its main thread."""
    _owns_process.set()


def check_interrupted() -> None:
    """Raises ``KeyboardInterrupt`` if Ctrl-C came since `noticing_ctrl_c` began."""
    if _interrupted.is_set():
        raise KeyboardInterrupt


def exit_now(code: int) -> NoReturn:
    """Ends the process at once, output flushed; torch needs a second and more to be unloaded in the usual way."""
    for stream in (sys.stdout, sys.stderr):
        # A reader that has gone is no reason to stay.
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)

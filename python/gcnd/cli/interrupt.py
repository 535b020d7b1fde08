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

__all__ = ["EXIT_INTERRUPTED", "check_interrupted", "exit_now", "noticing_ctrl_c"]

EXIT_INTERRUPTED = 130

_interrupted = threading.Event()


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

"""Processes that are forks of one that has run gcnd: its threads are missing in them, and they would wait for ever."""

from __future__ import annotations

import os

from gcnd.errors import GcndError

__all__ = ["refuse_fork"]

_seen = {"first": False, "fork": False}


def _note_fork() -> None:
    _seen["fork"] = True


def refuse_fork() -> None:
    """To be called before threads are started or asked for work.

    Raises:
        GcndError: This process is a fork of one in which that was done before.

    Example:
        >>> refuse_fork()
    """
    if _seen["fork"]:
        raise GcndError(
            "this process is a fork of one that has run gcnd, and has none of its threads",
            'start processes anew: multiprocessing.get_context("spawn")',
        )
    if not _seen["first"] and hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=_note_fork)
    _seen["first"] = True

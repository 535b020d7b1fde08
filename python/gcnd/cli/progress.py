"""Showing on stderr how far a long command has come."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from gcnd.cli.interrupt import check_interrupted

__all__ = ["ProgressCallback", "show_progress"]

ProgressCallback = Callable[[float, str], None]
"""Takes the fraction done, in [0, 1], and the name of the stage at work."""


@contextmanager
def show_progress(*, quiet: bool) -> Iterator[ProgressCallback]:
    """Shows progress while the block runs: a bar with the time left on a terminal, else a line per stage.

    Args:
        quiet: Whether to show nothing.

    Yields:
        The function to call with the fraction done and the stage.
    """
    if quiet:
        yield _checking(lambda fraction, stage: None)
    elif sys.stderr.isatty():
        with _bar() as callback:
            yield _checking(callback)
    else:
        yield _checking(_stage_printer())


def _checking(callback: ProgressCallback) -> ProgressCallback:
    """The callback, which also stops what calls it once Ctrl-C came."""

    def told(fraction: float, stage: str) -> None:
        check_interrupted()
        callback(fraction, stage)

    return told


@contextmanager
def _bar() -> Iterator[ProgressCallback]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    progress = Progress(*columns, console=Console(stderr=True), transient=True)
    task = progress.add_task("starting", total=1.0)

    def callback(fraction: float, stage: str) -> None:
        # Markup off: a stage such as "[1/2]" must not be taken for a style.
        from rich.markup import escape

        progress.update(task, completed=min(max(fraction, 0.0), 1.0), description=escape(stage))

    progress.start()
    try:
        yield callback
    finally:
        # A terminal that was closed cannot be cleared, which must not hide why the block ends.
        with suppress(OSError):
            progress.stop()


def _stage_printer() -> ProgressCallback:
    last_stage: list[str] = []

    def callback(fraction: float, stage: str) -> None:
        if last_stage != [stage]:
            last_stage[:] = [stage]
            print(f"{stage} ({fraction:.0%} done)", file=sys.stderr, flush=True)

    return callback

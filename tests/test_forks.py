"""A fork of a process that has run gcnd is told so, and does not wait for threads that it has not."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

PROGRAM = """
import multiprocessing, sys
import numpy as np
import gcnd

V, F = np.eye(3, 3), np.array([[0, 1, 2]])

def told(work):
    try:
        work()
    except gcnd.GcndError as error:
        return f"{error} / {error.hint}"
    return "done"

def noise():
    gcnd.data.noise.add_noise(V, F, level=0.1)

def child(queue):
    work = {"noise": noise, "load": lambda: gcnd.Denoiser("fast")}.get(kind, lambda: denoiser((V, F)))
    queue.put(told(work))

kind = sys.argv[1]
if kind == "noise":
    import gcnd.data.noise
    noise()
elif kind != "unused":
    denoiser = gcnd.Denoiser("fast")
if kind == "used":
    denoiser((V, F))
if kind == "unused":
    import gcnd.filters
    child = lambda queue: queue.put(told(lambda: gcnd.filters.apply_filter((V, F), "taubin")))
context = multiprocessing.get_context("fork")
queue = context.Queue()
process = context.Process(target=child, args=(queue,))
process.start()
print(queue.get(timeout=60))
process.join(60)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no forks here")
@pytest.mark.parametrize("kind", ["load", "fresh", "used", "noise", "unused"])
def test_a_fork_is_refused_once_its_parent_has_run_anything(kind: str) -> None:
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", PROGRAM, kind],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    if kind == "unused":
        assert done.stdout == "done\n"
    else:
        assert "is a fork of one that has run gcnd" in done.stdout
        assert 'multiprocessing.get_context("spawn")' in done.stdout

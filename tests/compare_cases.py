"""Methods that go right and wrong in a child process, and small meshes, for the tests of the comparison."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from gcnd.compare.cases import Case, CaseMesh
from gcnd.compare.methods import Method
from gcnd.data.noise import add_noise

Made = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def same(**_settings: Any) -> Made:
    return lambda vertices, faces: (vertices, faces)


def moved(by: float) -> Made:
    return lambda vertices, faces: (vertices + by, faces)


def turned(**_settings: Any) -> Made:
    """Begins each face at another corner, as some libraries do."""
    return lambda vertices, faces: (vertices, faces[:, [1, 2, 0]])


def slow_start(pause: float) -> Made:
    time.sleep(pause)
    return lambda vertices, faces: (vertices, faces)


def holding(mebibytes: int) -> Made:
    def run(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        held = np.ones(mebibytes << 17)
        return vertices + 0 * held[0], faces

    return run


def not_finite(**_settings: Any) -> Made:
    def run(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        vertices[[3, 5], 1] = np.nan
        return vertices, faces

    return run


def one_more(**_settings: Any) -> Made:
    return lambda vertices, faces: (np.vstack([vertices, vertices[:1]]), faces)


def faces_lost(**_settings: Any) -> Made:
    return lambda vertices, faces: (vertices, faces[:-1])


def reordered(**_settings: Any) -> Made:
    return lambda vertices, faces: (vertices, np.roll(faces, 1, axis=0))


def raising(**_settings: Any) -> Made:
    def run(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        raise ValueError("no such\n  vertex")

    return run


def crashing(**_settings: Any) -> Made:
    def run(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        print("a last word", flush=True)
        os.kill(os.getpid(), signal.SIGSEGV)
        return vertices, faces

    return run


def endless(**_settings: Any) -> Made:
    def run(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        time.sleep(600)
        return vertices, faces

    return run


def announced(path: str) -> Made:
    """Says by a file that it has begun, and does not end."""
    Path(path).touch()
    return endless()


def first_call_slow(pause: float) -> Made:
    calls: list[int] = []

    def run(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        time.sleep(0 if calls else pause)
        calls.append(len(faces))
        return vertices, faces

    return run


def processors(**_settings: Any) -> Made:
    """Writes how many processors it may use into the first coordinate."""

    def run(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        vertices[0] = len(os.sched_getaffinity(0)), int(os.environ["RAYON_NUM_THREADS"]), 0
        return vertices, faces

    return run


def method(function: Callable[..., Made], version: str = "1", **settings: Any) -> Method:
    name = function.__name__
    return Method(name, name, "tests", f"compare_cases:{name}", settings, version)


def ball(level: float = 0.2, seed: int = 1, subdivisions: int = 2) -> CaseMesh:
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
    truth, faces = np.array(sphere.vertices), np.array(sphere.faces, dtype=np.uint32)
    return CaseMesh(add_noise(truth, faces, level=level, seed=seed), truth, faces)


def case(name: str = "ball", level: float = 0.2, kind: str = "smooth") -> Case:
    return Case(name, kind, "gaussian", f"{level:g}", lambda: ball(level))


def write_meshes(folder: Path, *names: str) -> Path:
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        trimesh.creation.icosphere(subdivisions=2).export(path)
    return folder

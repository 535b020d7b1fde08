"""A mesh on disk and a stand-in for `gcnd.Denoiser`, for tests of the command line."""

from __future__ import annotations

import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from gcnd.controls import Controls
from gcnd.mesh_io import save, to_arrays
from gcnd.runs import Denoised

VERTICES = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def stand_in(monkeypatch: pytest.MonkeyPatch, module: str, **members: Any) -> None:
    """Puts a module of the given members in the place of a real one."""
    fake = types.ModuleType(module)
    vars(fake).update(members)
    monkeypatch.setitem(sys.modules, module, fake)


class FakeDenoiser:
    """Stands in for `gcnd.Denoiser`: moves everything by 1, and remembers what it was asked."""

    calls: list[dict[str, Any]]
    raised: BaseException | None = None

    def __init__(self, preset: str, *, controls: Controls, triangulate: bool, **options: Any) -> None:
        self.triangulate = triangulate
        self.call = {"preset": preset, **options, **controls.described()}

    def check_confidence(self) -> None:
        self.call["confidence"] = True

    def run(self, mesh: trimesh.Trimesh, *, progress: Any) -> Denoised:
        if self.raised is not None:
            raise self.raised
        self.calls.append({"mesh": mesh, **self.call})
        for fraction, stage in (
            (0.0, "normals, pass 1 of 2"),
            (0.3, "normals, pass 1 of 2"),
            (0.5, "[bold] 2"),
        ):
            progress(fraction, stage)
        before, rebuild = to_arrays(mesh)
        after = before.vertices + 1.0
        confidence = np.linspace(0.0, 1.0, len(mesh.faces))
        return Denoised(rebuild(after), confidence, before, after, {"normals": 0.25}, {"preset": "default"})


def write_mesh(folder: Path) -> Path:
    path = folder / "in.ply"
    save((VERTICES, FACES), path)
    return path


def replace_denoiser(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """Puts a fresh fake in the place of `gcnd.Denoiser`; returns where its calls will be."""
    calls: list[dict[str, Any]] = []
    stand_in(monkeypatch, "gcnd.denoiser", Denoiser=type("Fake", (FakeDenoiser,), {"calls": calls}))
    return calls

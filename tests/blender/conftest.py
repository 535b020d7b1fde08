"""Fixtures of the add-on in Blender; Blender is imported only by tests that have skipped without it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from test_docs_site import script


@pytest.fixture(scope="session")
def package(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The packed extension, installed for as long as there are tests."""
    import blender_scene as scene

    path: Path = script("blender_extension").pack(tmp_path_factory.mktemp("packed"))
    scene.install(path)
    yield path
    scene.bpy.ops.preferences.addon_disable(module=scene.ID)


@pytest.fixture
def ball(package: Path) -> Any:
    """A noisy ball of quads, with triangles at the poles, alone in a new file."""
    import blender_scene as scene

    return scene.new_ball()


@pytest.fixture
def lifted(ball: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The ball, and gcnd replaced by something quick that moves all vertices up."""
    import blender_scene as scene

    python_run = scene.module("runs").PythonRun
    monkeypatch.setattr(python_run, "_denoised", lambda run: run.mesh.positions + scene.UP)
    return ball

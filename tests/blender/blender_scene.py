"""Blender without a window, with the add-on packed and installed as an extension.

Tests that import this are skipped where the `bpy` wheel is not installed.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

# Before Blender is imported: its settings and extensions of these tests are not those of whoever runs them.
HOME = tempfile.TemporaryDirectory(prefix="gcnd_blender_")
os.environ["BLENDER_USER_RESOURCES"] = HOME.name
bpy = pytest.importorskip("bpy", reason="Blender's Python module is not installed: pip install bpy")

ID = "bl_ext.user_default.gcnd_denoise"
UP = np.array([0.0, 0.0, 0.5], dtype=np.float32)


def install(path: Path) -> None:
    """Installs a packed extension and switches it on, as dropping it onto Blender does."""
    done = bpy.ops.extensions.package_install_files(
        filepath=str(path), repo="user_default", enable_on_install=True
    )
    assert done == {"FINISHED"}
    assert ID in bpy.context.preferences.addons


def new_ball() -> Any:
    """A noisy ball of quads, with triangles at the poles, alone in a new file."""
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.mesh.primitive_uv_sphere_add(segments=32, ring_count=16, calc_uvs=True)
    ball = bpy.context.active_object
    noise = np.random.default_rng(5).normal(scale=0.02, size=(len(ball.data.vertices), 3))
    put(ball.data, co(ball) + noise.astype(np.float32))
    for name, value in {"runner": "PYTHON", "command": "gcnd", "presets": ""}.items():
        setattr(settings_of_addon(), name, value)
    ball.gcnd_denoise.preset = "fast"
    return ball


def module(name: str) -> Any:
    return sys.modules[f"{ID}.{name}"]


def settings_of_addon() -> Any:
    return bpy.context.preferences.addons[ID].preferences


def read(collection: Any, name: str, width: int, dtype: type = np.float32) -> np.ndarray:
    values = np.empty(len(collection) * width, dtype)
    collection.foreach_get(name, values)
    return values.reshape(-1, width)


def co(obj: Any) -> np.ndarray:
    return read(obj.data.vertices, "co", 3)


def put(mesh: Any, positions: np.ndarray) -> None:
    mesh.vertices.foreach_set("co", positions.astype(np.float32).ravel())
    mesh.update()

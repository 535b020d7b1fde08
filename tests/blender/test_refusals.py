"""The add-on in Blender: what it cannot do is told with a hint, and nothing changes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blender_scene import bpy, co, module, put, settings_of_addon

import gcnd


def no_object(ball: Any, folder: Path) -> None:
    bpy.context.view_layer.objects.active = None


def a_light(ball: Any, folder: Path) -> None:
    bpy.ops.object.light_add()


def edit_mode(ball: Any, folder: Path) -> None:
    bpy.ops.object.mode_set(mode="EDIT")


def empty(ball: Any, folder: Path) -> None:
    ball.data.clear_geometry()


def loose(ball: Any, folder: Path) -> None:
    ball.data.clear_geometry()
    ball.data.vertices.add(3)


def not_a_number(ball: Any, folder: Path) -> None:
    positions = co(ball)
    positions[9, 1] = np.nan
    put(ball.data, positions)


def no_group(ball: Any, folder: Path) -> None:
    ball.gcnd_denoise.keep = "gone"


def no_program(ball: Any, folder: Path) -> None:
    settings_of_addon().runner, settings_of_addon().command = "COMMAND", str(folder / "gone")


def linked(ball: Any, folder: Path) -> None:
    path = str(folder / "library.blend")
    bpy.data.libraries.write(path, {ball})
    bpy.ops.wm.read_homefile(use_empty=True)
    with bpy.data.libraries.load(path, link=True) as (_, taken):
        taken.objects = ["Sphere"]
    bpy.context.collection.objects.link(bpy.data.objects["Sphere"])
    bpy.context.view_layer.objects.active = bpy.data.objects["Sphere"]


def linked_mesh(ball: Any, folder: Path) -> None:
    linked(ball, folder)
    local = bpy.data.objects.new("local", bpy.data.objects["Sphere"].data)
    bpy.context.collection.objects.link(local)
    bpy.context.view_layer.objects.active = local


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (no_object, "No mesh object is active\nHint: click one"),
        (a_light, "No mesh object is active"),
        (edit_mode, "Sphere is in Edit Mode\nHint: change to Object Mode"),
        (empty, "The mesh is empty"),
        (loose, "The mesh has no faces"),
        (not_a_number, "1 vertices have positions that are not finite, the first is vertex 9"),
        (no_group, "Sphere has no vertex group 'gone'"),
        (no_program, "There is no program '.*gone'\nHint: install gcnd"),
        (linked, "Sphere is linked from another file\nHint: Object > Relations > Make Local"),
        (linked_mesh, "local is linked from another file"),
    ],
)
@pytest.mark.parametrize("name", ["preview", "apply"])
def test_what_cannot_be_done_is_told_with_a_hint(
    lifted: Any, tmp_path: Path, change: Callable[[Any, Path], None], message: str, name: str
) -> None:
    change(lifted, tmp_path)
    n_meshes = len(bpy.data.meshes)
    with pytest.raises(RuntimeError, match=f"Error: {message}"):
        getattr(bpy.ops.gcnd, name)()
    assert len(bpy.data.meshes) == n_meshes
    assert module("denoising").running() is None


def test_an_error_of_gcnd_is_told_with_its_hint(ball: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def denoise(mesh: Any, **options: Any) -> Any:
        raise gcnd.MeshError("too large", hint="halve it")

    monkeypatch.setattr(gcnd, "denoise", denoise)
    before = co(ball)
    with pytest.raises(RuntimeError, match="Error: too large\nHint: halve it"):
        bpy.ops.gcnd.apply()
    assert np.array_equal(co(ball), before)

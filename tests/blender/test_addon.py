"""The add-on in Blender: what is denoised, shown and written, and what stays."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blender_cases import executable
from blender_scene import UP, bpy, co, module, put, read, settings_of_addon

import gcnd
from gcnd.weights import list_models


def group_of(obj: Any, ids: range) -> np.ndarray:
    obj.vertex_groups.new(name="stay").add(list(ids), 0.5, "REPLACE")
    obj.vertex_groups["stay"].add([0], 0.0, "REPLACE")
    obj.gcnd_denoise.keep = "stay"
    is_kept = np.zeros(len(obj.data.vertices), dtype=bool)
    is_kept[[i for i in ids if i != 0]] = True
    return is_kept


def test_blender_finds_nothing_wrong_with_the_extension(package: Path) -> None:
    program = Path(bpy.utils.system_resource("SCRIPTS")) / "addons_core/bl_pkg/cli/blender_ext.py"
    done = subprocess.run([sys.executable, program, "validate", package], capture_output=True, text=True)
    assert (done.returncode, "Success" in done.stdout) == (0, True), done.stdout + done.stderr


def test_a_ball_of_quads_is_denoised_and_stays_what_it_was(ball: Any) -> None:
    mesh = ball.data
    mesh.materials.append(bpy.data.materials.new("clay"))
    mesh.color_attributes.new("paint", "BYTE_COLOR", "CORNER").data[5].color = (0.2, 0.4, 0.6, 1.0)
    ball.vertex_groups.new(name="top").add([3, 4], 0.25, "REPLACE")

    def rest() -> list[Any]:
        return [
            read(mesh.loops, "vertex_index", 1, np.int32).tolist(),
            [p.loop_total for p in mesh.polygons],
            read(mesh.uv_layers[0].uv, "vector", 2).tolist(),
            read(mesh.color_attributes["paint"].data, "color", 4).tolist(),
            [(g.group, g.weight) for v in mesh.vertices for g in v.groups],
            [m.name for m in mesh.materials],
            sorted(a.name for a in mesh.attributes),
        ]

    before, kept = co(ball), rest()
    assert 4 in kept[1]
    mesh.calc_loop_triangles()
    faces = read(mesh.loop_triangles, "vertices", 3, np.int32)
    assert bpy.ops.gcnd.apply() == {"FINISHED"}
    expected = gcnd.denoise((before, faces), preset="fast")[0]
    assert np.array_equal(co(ball), expected)
    assert rest() == kept
    truth = before / np.linalg.norm(before, axis=1, keepdims=True)
    assert gcnd.normal_error(co(ball), truth, faces) < gcnd.normal_error(before, truth, faces) / 2


@pytest.mark.skipif(os.name == "nt", reason="the command is a shell script")
def test_the_command_gives_the_same_bits_as_blenders_python(ball: Any, tmp_path: Path) -> None:
    before = co(ball)
    bpy.ops.gcnd.apply()
    in_python = co(ball)
    put(ball.data, before)
    settings_of_addon().runner = "COMMAND"
    settings_of_addon().command = str(executable(tmp_path, sys.executable, "-m", "gcnd"))
    bpy.ops.gcnd.apply()
    assert np.array_equal(co(ball), in_python)
    assert np.abs(in_python - before).max() > 0.01


def test_a_preview_leaves_the_mesh_alone_and_goes_without_a_trace(lifted: Any) -> None:
    mesh, before = lifted.data, co(lifted)
    assert bpy.ops.gcnd.preview() == {"FINISHED"}
    assert lifted.data != mesh
    assert np.array_equal(co(lifted), before + UP)
    assert np.array_equal(read(mesh.vertices, "co", 3), before)
    assert bpy.ops.gcnd.preview() == {"FINISHED"}
    assert len(bpy.data.meshes) == 2
    assert bpy.ops.gcnd.back() == {"FINISHED"}
    assert lifted.data == mesh
    assert list(bpy.data.meshes) == [mesh]
    assert lifted.gcnd_denoise.own_mesh is None
    assert np.array_equal(co(lifted), before)
    assert not bpy.ops.gcnd.back.poll()


def test_strength_and_group_change_the_preview_at_once(lifted: Any) -> None:
    before, keep = co(lifted), group_of(lifted, range(50))
    bpy.ops.gcnd.preview()
    expected = np.where(keep[:, None], before, before + UP)
    assert np.array_equal(co(lifted), expected)
    lifted.gcnd_denoise.strength = 0.5
    np.testing.assert_allclose(co(lifted), (before + expected) / 2, rtol=0, atol=1e-6)
    lifted.gcnd_denoise.keep = ""
    np.testing.assert_allclose(co(lifted), before + UP / 2, rtol=0, atol=1e-6)
    lifted.gcnd_denoise.strength = 0.0
    assert co(lifted).tobytes() == before.tobytes()


def test_what_is_applied_is_what_the_preview_shows(lifted: Any, capfd: pytest.CaptureFixture[str]) -> None:
    mesh, before = lifted.data, co(lifted)
    group_of(lifted, range(50))
    lifted.gcnd_denoise.strength = 0.25
    bpy.ops.gcnd.preview()
    shown = co(lifted)
    assert bpy.ops.gcnd.apply() == {"FINISHED"}
    assert lifted.data == mesh
    assert len(bpy.data.meshes) == 1
    assert np.array_equal(co(lifted), shown)
    assert "433 of 482 vertices moved, 0.125 at most" in capfd.readouterr().out
    put(mesh, before)
    bpy.ops.gcnd.apply()
    assert np.array_equal(co(lifted), shown)


def test_a_mesh_that_was_edited_under_its_preview_is_not_overwritten(lifted: Any) -> None:
    mesh, before = lifted.data, co(lifted)
    bpy.ops.gcnd.preview()
    mesh.vertices[7].co.x += 1.0
    with pytest.raises(RuntimeError, match=r"edited since.*\n.*preview it again"):
        bpy.ops.gcnd.apply()
    mesh.vertices[7].co.x = before[7, 0]
    lifted.data.attributes.remove(lifted.data.attributes["gcnd_after"])
    with pytest.raises(RuntimeError, match="edited since"):
        bpy.ops.gcnd.apply()
    assert np.array_equal(read(mesh.vertices, "co", 3), before)


def test_a_preview_is_saved_with_the_file(lifted: Any, tmp_path: Path) -> None:
    before = co(lifted)
    bpy.ops.gcnd.preview()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    obj = bpy.context.active_object
    obj.gcnd_denoise.strength = 0.5
    np.testing.assert_allclose(co(obj), before + UP / 2, rtol=0, atol=1e-6)
    bpy.ops.gcnd.back()
    assert np.array_equal(co(obj), before)


def test_undo_takes_back_what_was_applied(lifted: Any) -> None:
    before = co(lifted)
    bpy.ops.ed.undo_push(message="start")
    bpy.ops.gcnd.preview()
    bpy.ops.ed.undo_push(message="preview")
    bpy.ops.gcnd.apply()
    bpy.ops.ed.undo_push(message="apply")
    assert np.array_equal(co(bpy.context.active_object), before + UP)
    assert bpy.context.active_object.gcnd_denoise.own_mesh is None
    bpy.ops.ed.undo()
    assert bpy.context.active_object.gcnd_denoise.own_mesh is not None
    bpy.ops.gcnd.back()
    assert np.array_equal(co(bpy.context.active_object), before)


def test_shape_keys_move_with_their_basis(lifted: Any) -> None:
    before = co(lifted)
    lifted.shape_key_add(name="Basis")
    wide = lifted.shape_key_add(name="wide")
    wide.data.foreach_set("co", (before * 2).ravel())
    lifted.active_shape_key_index = 1
    wide.value = 1.0
    bpy.ops.gcnd.preview()
    shown = lifted.evaluated_get(bpy.context.evaluated_depsgraph_get())
    np.testing.assert_allclose(co(shown), before * 2 + UP, rtol=0, atol=1e-6)
    bpy.ops.gcnd.back()
    keys = lifted.data.shape_keys.key_blocks
    assert np.array_equal(read(keys["wide"].data, "co", 3), before * 2)
    bpy.ops.gcnd.apply()
    np.testing.assert_array_equal(read(keys["Basis"].data, "co", 3), before + UP)
    np.testing.assert_allclose(read(keys["wide"].data, "co", 3), before * 2 + UP, rtol=0, atol=1e-6)
    assert len(bpy.data.shape_keys) == 1


def test_a_shared_mesh_changes_for_all_and_that_is_said(
    lifted: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    other = lifted.copy()
    bpy.context.collection.objects.link(other)
    before = co(other)
    bpy.ops.gcnd.preview()
    assert np.array_equal(co(other), before)
    bpy.ops.gcnd.apply()
    assert np.array_equal(co(other), before + UP)
    assert (
        "Warning: 482 of 482 vertices moved, 0.5 at most; the mesh is shared: 2 objects"
        in capfd.readouterr().out
    )


def test_modifiers_and_scale_are_told_of(lifted: Any, capfd: pytest.CaptureFixture[str]) -> None:
    before = co(lifted)
    lifted.modifiers.new("fine", "SUBSURF")
    lifted.scale = (1.0, -1.0, 1.0)
    bpy.ops.gcnd.apply()
    assert np.array_equal(co(lifted), before + UP)
    assert "0.5 at most; the base mesh was denoised, before its modifiers\n" in capfd.readouterr().out
    assert lifted.modifiers["fine"].type == "SUBSURF"
    lifted.scale = (1.0, 1.0, 2.0)
    bpy.ops.gcnd.preview()
    assert "apply the scale first" in capfd.readouterr().out


def test_presets_are_read_from_gcnd(ball: Any) -> None:
    def names() -> list[str]:
        items = module("settings")._preset_items(ball.gcnd_denoise, bpy.context)
        return [name for name, _, _ in items]

    assert names() == ["auto", "default", "fast"]
    assert bpy.ops.gcnd.read_presets() == {"FINISHED"}
    assert names() == ["auto", *(model.name for model in list_models())]
    assert ball.gcnd_denoise.preset == "fast"
    ball.gcnd_denoise.preset = "paper"
    settings_of_addon().presets = ""
    with pytest.raises(RuntimeError, match="No preset is chosen"):
        bpy.ops.gcnd.apply()


def test_gcnd_in_blenders_python_is_found(ball: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    addon = settings_of_addon()
    addon.runner = "AUTO"
    assert addon.runs_in_python() is True
    monkeypatch.setattr(module("settings"), "has_gcnd", lambda: False)
    assert addon.runs_in_python() is False

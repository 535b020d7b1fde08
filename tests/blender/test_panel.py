"""The panel and the preferences: what they offer, drawn into a stand-in that knows the calls of Blender's layouts."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from blender_scene import bpy, module, settings_of_addon


class Layout:
    """Notes what is drawn, and refuses what Blender's layouts do not have."""

    def __init__(self, drawn: list[str]) -> None:
        self.drawn = drawn

    def __getattr__(self, name: str) -> Any:
        parameters = bpy.types.UILayout.bl_rna.functions[name].parameters

        def call(*arguments: Any, **options: Any) -> Layout:
            assert set(options) <= set(parameters.keys())
            if name in ("prop", "prop_search"):
                owner, what = arguments[:2]
                assert what in owner.bl_rna.properties
                self.drawn.append(what)
            elif name == "operator":
                category, _, last = arguments[0].partition(".")
                getattr(getattr(bpy.ops, category), last).get_rna_type()
                self.drawn.append(arguments[0])
            elif name in ("label", "progress"):
                self.drawn.append(options["text"])
            return Layout(self.drawn)

        return call


def drawn(active_object: Any) -> list[str]:
    found: list[str] = []
    panel = SimpleNamespace(layout=Layout(found))
    module("panel").GCND_PT_denoise.draw(panel, SimpleNamespace(active_object=active_object))
    return found


def test_what_the_panel_offers(lifted: Any) -> None:
    settings = ["preset", "strength", "keep"]
    assert drawn(lifted) == [*settings, "gcnd.preview", "gcnd.apply"]
    bpy.ops.gcnd.preview()
    assert drawn(lifted)[:6] == [*settings, "gcnd.preview", "gcnd.back", "gcnd.apply"]
    assert "edits of it are lost" in drawn(lifted)[6]
    bpy.ops.object.light_add()
    assert drawn(bpy.context.active_object) == drawn(None) == ["No mesh object is active"]


def test_while_gcnd_runs_the_panel_shows_how_far_it_is(lifted: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    job = SimpleNamespace(run=SimpleNamespace(fraction=0.5, stage="normals"))
    monkeypatch.setattr(module("panel"), "running", lambda: job)
    assert drawn(lifted) == ["normals", "Esc stops it"]


def test_what_the_preferences_offer(lifted: Any) -> None:
    found: list[str] = []
    addon = settings_of_addon()
    stand_in = SimpleNamespace(layout=Layout(found), bl_rna=addon.bl_rna, runs_in_python=addon.runs_in_python)
    module("settings").GcndPreferences.draw(stand_in, None)
    assert found == ["runner", "command", "gcnd.read_presets"]

"""What the user sets: by object in the panel, and once in the add-on's preferences."""

from __future__ import annotations

from functools import lru_cache

import bpy

from . import presets, preview
from .arrays import Triangles
from .runs import CommandRun, PythonRun, Run, find_command, has_gcnd

__all__ = ["CLASSES", "GcndPreferences", "ObjectSettings", "preferences"]


def preferences() -> GcndPreferences:
    """Returns the add-on's preferences."""
    return bpy.context.preferences.addons[__package__].preferences


@lru_cache
def _items(text: str) -> list[tuple[str, str, str]]:
    """Entries of the menu; kept, since Blender does not hold on to the strings of a dynamic menu itself."""
    found = presets.parsed(text) if text else presets.KNOWN
    return [(name, name.replace("_", " ").title(), line) for name, line in found]


def _preset_items(self: ObjectSettings, context: bpy.types.Context | None) -> list[tuple[str, str, str]]:
    return _items(preferences().presets)


def _refresh(self: ObjectSettings, context: bpy.types.Context | None) -> None:
    preview.refresh(self.id_data)


class ObjectSettings(bpy.types.PropertyGroup):
    """Settings of one object, saved with it."""

    preset: bpy.props.EnumProperty(name="Preset", description="Weights to denoise with", items=_preset_items)
    strength: bpy.props.FloatProperty(
        name="Strength",
        description="Share of its way that every vertex goes: 0 is the mesh as it was, 1 the full result",
        default=1.0,
        min=0.0,
        max=1.0,
        subtype="FACTOR",
        update=_refresh,
    )
    keep: bpy.props.StringProperty(
        name="Keep", description="Vertices of this group stay where they are", update=_refresh
    )
    own_mesh: bpy.props.PointerProperty(
        type=bpy.types.Mesh, name="Own mesh", description="The object's mesh while it shows a preview"
    )


class GcndPreferences(bpy.types.AddonPreferences):
    """How gcnd is run, and the presets it has."""

    bl_idname = __package__

    runner: bpy.props.EnumProperty(
        name="Run gcnd",
        items=(
            ("AUTO", "As it is found", "In Blender's Python if gcnd is installed there, else by its command"),
            ("PYTHON", "In Blender's Python", "gcnd must be installed there"),
            ("COMMAND", "By its command", "A program of its own: nothing is installed into Blender"),
        ),
    )
    command: bpy.props.StringProperty(
        name="Command",
        description="The gcnd program: a name on the search path, or a path",
        default="gcnd",
        subtype="FILE_PATH",
    )
    presets: bpy.props.StringProperty(name="Presets", options={"HIDDEN"})

    def runs_in_python(self) -> bool:
        """Says whether gcnd runs in Blender's own Python."""
        return has_gcnd() if self.runner == "AUTO" else self.runner == "PYTHON"

    def find_command(self) -> tuple[str, ...]:
        """Returns the program to call; raises ``Failure`` where there is none."""
        return find_command(bpy.path.abspath(self.command))

    def make_run(self, mesh: Triangles, preset: str) -> Run:
        """Makes a run of the chosen kind ready."""
        if self.runs_in_python():
            return PythonRun(mesh, preset)
        return CommandRun(mesh, preset, self.find_command())

    def read_presets(self) -> None:
        """Takes the presets of the installed gcnd into the panel's menu."""
        found = presets.from_python() if self.runs_in_python() else presets.from_command(self.find_command())
        self.presets = presets.stored(found)

    def draw(self, context: bpy.types.Context) -> None:
        """Draws the preferences."""
        self.layout.prop(self, "runner")
        row = self.layout.row()
        row.enabled = not self.runs_in_python()
        row.prop(self, "command")
        self.layout.operator("gcnd.read_presets", icon="FILE_REFRESH")


CLASSES = (ObjectSettings, GcndPreferences)

"""The panel's buttons: preview, apply, back; and reading the list of presets."""

from __future__ import annotations

from typing import ClassVar

import bpy

from . import preview
from .denoising import Applying, Previewing, running
from .errors import Failure
from .settings import preferences

__all__ = ["CLASSES"]


class GCND_OT_preview(Previewing, bpy.types.Operator):
    """Show the denoised mesh; the mesh itself stays as it is."""

    bl_idname = "gcnd.preview"
    bl_label = "Preview"


class GCND_OT_apply(Applying, bpy.types.Operator):
    """Move the mesh's vertices to where the preview has them; without a preview, run gcnd first."""

    bl_idname = "gcnd.apply"
    bl_label = "Apply"


class GCND_OT_back(bpy.types.Operator):
    """Show the mesh as it is again."""

    bl_idname = "gcnd.back"
    bl_label = "Back"
    bl_options: ClassVar[set[str]] = {"UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a preview to go back from."""
        obj = context.active_object
        return running() is None and obj is not None and obj.mode == "OBJECT" and preview.is_shown(obj)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Ends the preview."""
        preview.end(context.active_object)
        return {"FINISHED"}


class GCND_OT_read_presets(bpy.types.Operator):
    """Run gcnd once and list the presets it has."""

    bl_idname = "gcnd.read_presets"
    bl_label = "Find gcnd and Read Its Presets"

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Reads the presets into the preferences."""
        try:
            preferences().read_presets()
        except Failure as failure:
            self.report({"ERROR"}, failure.text())
            return {"CANCELLED"}
        self.report({"INFO"}, "gcnd was found")
        return {"FINISHED"}


CLASSES = (GCND_OT_preview, GCND_OT_apply, GCND_OT_back, GCND_OT_read_presets)

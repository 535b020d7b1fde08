"""The panel in the sidebar of the 3D view."""

from __future__ import annotations

import bpy

from . import preview
from .denoising import running

__all__ = ["CLASSES"]


class GCND_PT_denoise(bpy.types.Panel):
    """Preset, strength, what to keep, preview and apply."""

    bl_idname = "GCND_PT_denoise"
    bl_label = "Denoise"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "gcnd"

    def draw(self, context: bpy.types.Context) -> None:
        """Draws the panel for the active object."""
        layout, obj, job = self.layout, context.active_object, running()
        layout.use_property_split = True
        if job is not None:
            layout.progress(factor=job.run.fraction, text=job.run.stage)
            layout.label(text="Esc stops it")
            return
        if obj is None or obj.type != "MESH":
            layout.label(text="No mesh object is active")
            return
        settings, is_shown = obj.gcnd_denoise, preview.is_shown(obj)
        column = layout.column()
        column.enabled = obj.mode == "OBJECT"
        column.prop(settings, "preset")
        column.prop(settings, "strength")
        column.prop_search(settings, "keep", obj, "vertex_groups")
        row = column.row(align=True)
        row.operator("gcnd.preview", text="Preview Again" if is_shown else "Preview")
        if is_shown:
            row.operator("gcnd.back")
        column.operator("gcnd.apply")
        if is_shown:
            layout.label(text="This is a preview; edits of it are lost", icon="INFO")


CLASSES = (GCND_PT_denoise,)

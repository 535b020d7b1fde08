"""Everything that Blender is told of when the add-on is switched on, and forgets when it is switched off."""

from __future__ import annotations

import bpy

from . import denoising, operators, panel, settings

__all__ = ["register", "unregister"]

_CLASSES = (*settings.CLASSES, *operators.CLASSES, *panel.CLASSES)


def register() -> None:
    """Registers the classes and the settings that every object has."""
    for each in _CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Object.gcnd_denoise = bpy.props.PointerProperty(type=settings.ObjectSettings)


def unregister() -> None:
    """Stops what runs and takes everything back."""
    denoising.stop()
    del bpy.types.Object.gcnd_denoise
    for each in reversed(_CLASSES):
        bpy.utils.unregister_class(each)

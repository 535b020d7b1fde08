"""gcnd in Blender: a panel in the sidebar of the 3D view that removes the noise of the active mesh.

Blender is imported only when the add-on is switched on, so that what needs no Blender is tested without one.
"""

from __future__ import annotations

__all__ = ["register", "unregister"]


def register() -> None:
    """Makes the panel, the operators and the settings known to Blender."""
    from . import registration

    registration.register()


def unregister() -> None:
    """Stops what runs and takes everything out of Blender again."""
    from . import registration

    registration.unregister()

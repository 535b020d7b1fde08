"""Other people's libraries, one module each: what they offer, at their documented defaults and tuned."""

from __future__ import annotations

from gcnd.compare.adapters import meshlib, open3d, pymeshlab, pyvista, trimesh
from gcnd.compare.adapters.base import Adapted, Denoiser, Library, Setting

__all__ = ["LIBRARIES", "Adapted", "Denoiser", "Library", "Setting"]

# A new library is one module and one name here.
LIBRARIES: dict[str, Library] = {
    module.LIBRARY.name: module.LIBRARY for module in (pymeshlab, meshlib, open3d, trimesh, pyvista)
}
"""By the name before the colon."""

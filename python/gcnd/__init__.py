"""gcnd: learned, feature-preserving mesh denoising.

>>> import gcnd
>>> clean = gcnd.denoise("scan.ply")  # doctest: +SKIP
"""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.metadata import version as _version
from types import ModuleType
from typing import TYPE_CHECKING, Any

from gcnd.errors import Cancelled, ConfigError, GcndError, MeshError, MeshWarning, WeightsError

if TYPE_CHECKING:
    from gcnd.controls import Controls
    from gcnd.denoise import denoise
    from gcnd.denoiser import Denoiser
    from gcnd.many import denoise_many
    from gcnd.metrics import normal_error, vertex_error
    from gcnd.viewer.view import view

__version__ = _version("gcnd")

__all__ = [
    "Cancelled",
    "ConfigError",
    "Controls",
    "Denoiser",
    "GcndError",
    "MeshError",
    "MeshWarning",
    "WeightsError",
    "__version__",
    "denoise",
    "denoise_many",
    "normal_error",
    "vertex_error",
    "view",
]

_HOMES = {
    "Controls": "gcnd.controls",
    "Denoiser": "gcnd.denoiser",
    "denoise": "gcnd.denoise",
    "denoise_many": "gcnd.many",
    "normal_error": "gcnd.metrics",
    "vertex_error": "gcnd.metrics",
    "view": "gcnd.viewer.view",
}


def __getattr__(name: str) -> Any:
    # torch takes seconds to import; `gcnd --help` and `gcnd info` do without it.
    if name not in _HOMES:
        raise AttributeError(f"module 'gcnd' has no attribute {name!r}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


class _Package(ModuleType):
    """Keeps `gcnd.denoise` the function: importing the module of that name binds the module here."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name in _HOMES and isinstance(value, ModuleType):
            value = getattr(value, name)
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package

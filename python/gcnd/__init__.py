"""gcnd: learned, feature-preserving mesh denoising.

>>> import gcnd
>>> clean = gcnd.denoise("scan.ply")  # doctest: +SKIP
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import version as _version
from typing import TYPE_CHECKING, Any

from gcnd.errors import ConfigError, GcndError, MeshError, WeightsError

if TYPE_CHECKING:
    from gcnd.denoise import denoise
    from gcnd.metrics import normal_error, vertex_error

__version__ = _version("gcnd")

__all__ = [
    "ConfigError",
    "GcndError",
    "MeshError",
    "WeightsError",
    "__version__",
    "denoise",
    "normal_error",
    "vertex_error",
]

_HOMES = {"denoise": "gcnd.denoise", "normal_error": "gcnd.metrics", "vertex_error": "gcnd.metrics"}


def __getattr__(name: str) -> Any:
    # torch takes seconds to import; `gcnd --help` and `gcnd info` do without it.
    if name not in _HOMES:
        raise AttributeError(f"module 'gcnd' has no attribute {name!r}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value

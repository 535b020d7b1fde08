"""gcnd: learned, feature-preserving mesh denoising.

>>> import gcnd
>>> clean = gcnd.denoise("scan.ply")  # doctest: +SKIP
"""

from importlib.metadata import version as _version

from gcnd.denoise import denoise
from gcnd.errors import ConfigError, GcndError, MeshError, WeightsError
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

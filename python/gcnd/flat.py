"""Which meshes are flat for a good part, as machine parts are: some steps serve these only."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from gcnd import _geom

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = ["FLAT_DEGREES", "FLAT_SHARE", "is_flat"]

FLAT_SHARE, FLAT_DEGREES = 0.3, 1.0
"""A mesh is flat for a good part where across this share of its edges it goes on in one plane, to within this angle.

Choice: docs/choices.md#flat-meshes.
"""


def is_flat(topology: _geom.Topology, vertices: NDArray[np.float64]) -> bool:
    """Whether a mesh that all passes but the last have denoised is flat for a good part, as machine parts are.

    Choice: docs/choices.md#flat-meshes.
    """
    return _geom.flat_share(topology, vertices, math.radians(FLAT_DEGREES)) >= FLAT_SHARE

"""What must be known of a binary glTF file before its parser is trusted with it.

trimesh reads the file; what it would skip or fill with zeros without a word is refused here.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from gcnd.errors import MeshError
from gcnd.formats.parsed import DAMAGED_HINT, truncated_error

__all__ = ["check_glb"]

_HARMLESS_EXTENSIONS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "KHR_xmp")
_MODE_NAMES = {0: "points", 1: "lines", 2: "a line loop", 3: "a line strip", 6: "a triangle fan"}
_TRIANGLES, _TRIANGLE_STRIP = 4, 5


def check_glb(data: bytes) -> None:
    """Checks that a GLB file is whole and that nothing of its shape would be lost in reading.

    Args:
        data: The whole file.

    Raises:
        MeshError: If the file is no GLB file or cut off; if it needs an extension that changes geometry
            (such as Draco compression); or if it has sparse accessors, or primitives other than triangles.
    """
    if data[:4] != b"glTF":
        raise MeshError(
            "it does not start with the word 'glTF'", "check that the extension matches the content"
        )
    length = int.from_bytes(data[8:12], "little")
    if len(data) < max(length, 20):
        raise truncated_error("bytes", length, len(data))
    json_length = int.from_bytes(data[12:16], "little")
    try:
        header = json.loads(data[20 : 20 + json_length])
    except (UnicodeDecodeError, json.JSONDecodeError):
        raise MeshError("its JSON header cannot be read", DAMAGED_HINT) from None
    if not isinstance(header, dict):
        raise MeshError("its JSON header is no object", DAMAGED_HINT)
    for extension in header.get("extensionsRequired", []):
        if not str(extension).startswith(_HARMLESS_EXTENSIONS):
            raise MeshError(
                f"it needs the glTF extension {extension}, which is not supported",
                "export it again without compression or quantization",
            )
    if any("sparse" in accessor for accessor in header.get("accessors", [])):
        raise MeshError("it uses sparse accessors, which are not supported", "export it again as PLY")
    _check_primitives(header)


def _check_primitives(header: Mapping[str, Any]) -> None:
    for mesh_id, mesh in enumerate(header.get("meshes", [])):
        for primitive_id, primitive in enumerate(mesh.get("primitives", [])):
            mode = primitive.get("mode", _TRIANGLES)
            if mode not in (_TRIANGLES, _TRIANGLE_STRIP):
                raise MeshError(
                    f"primitive {primitive_id} of mesh {mesh_id} holds "
                    f"{_MODE_NAMES.get(mode, f'mode {mode}')}, not triangles",
                    "export only the triangles",
                )

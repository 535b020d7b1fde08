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
_ITEM_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_ITEMS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


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
    except (ValueError, RecursionError):
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
    _check_sizes(header, len(data))
    _check_primitives(header)


def _check_sizes(header: Mapping[str, Any], n_bytes: int) -> None:
    """Checks that what is announced lies inside what is there, before anything of that size is allocated."""
    views, buffers = header.get("bufferViews", []), header.get("buffers", [])
    for view_id, view in enumerate(views):
        buffer = _entry(buffers, view.get("buffer"), f"view {view_id}", "buffer")
        # A buffer with a name of its own is another file, whose reader sees how long it is.
        size = _count(buffer, "byteLength") if "uri" in buffer else min(_count(buffer, "byteLength"), n_bytes)
        end = _count(view, "byteOffset", 0) + _count(view, "byteLength")
        if end > size:
            raise truncated_error(f"bytes up to the end of view {view_id}", end, size)
    for accessor_id, accessor in enumerate(header.get("accessors", [])):
        count, start = _count(accessor, "count"), _count(accessor, "byteOffset", 0)
        view = _entry(views, accessor.get("bufferView"), f"accessor {accessor_id}", "view")
        item = _ITEM_BYTES.get(accessor.get("componentType"), 0) * _ITEMS.get(accessor.get("type"), 0)
        if not item:
            raise MeshError(f"accessor {accessor_id} is of no known type", DAMAGED_HINT)
        end = start + (max(count, 1) - 1) * (_count(view, "byteStride", 0) or item) + item * min(count, 1)
        if end > _count(view, "byteLength"):
            raise truncated_error(f"bytes for accessor {accessor_id}", end, _count(view, "byteLength"))


def _entry(entries: Any, index: Any, who: str, what: str) -> Mapping[str, Any]:
    is_there = isinstance(index, int) and isinstance(entries, list) and 0 <= index < len(entries)
    entry = entries[index] if is_there else None
    if not isinstance(entry, dict):
        raise MeshError(f"{who} has no {what} of data", DAMAGED_HINT)
    return entry


def _count(entry: Mapping[str, Any], key: str, default: int | None = None) -> int:
    value = entry.get(key, default)
    if not isinstance(value, int) or value < 0:
        raise MeshError(f"{key} is {value!r} in its header, not a count", DAMAGED_HINT)
    return value


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

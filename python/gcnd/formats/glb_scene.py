"""The shape of a whole glTF scene, whatever its materials, and the file written again with it moved."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gcnd.errors import MeshError
from gcnd.formats.parsed import DAMAGED_HINT, ParsedMesh
from gcnd.memory import check_memory
from gcnd.meshes.normals import Motion

__all__ = ["read_glb_shape", "rewrite_glb"]

Points = NDArray[np.float64]
Fetch = Callable[[str], bytes]
"""Reads another file that the scene names."""

_DTYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_TRIANGLE_STRIP = 5
_DATA_URI = "base64,"


@dataclass
class _Part:
    """One primitive at one place of the scene."""

    attributes: dict[str, int]
    matrix: Points
    faces: NDArray[np.int64]


class _Glb:
    """A binary glTF file, its buffers free to be changed; other files, only to be read, come from ``fetch``."""

    def __init__(self, data: bytes, fetch: Fetch | None = None) -> None:
        self.fetch = fetch
        n_json = int.from_bytes(data[12:16], "little")
        self.version = data[4:8]
        self.header: dict[str, Any] = json.loads(data[20 : 20 + n_json])
        self.chunks = data[20 + n_json :]
        n_binary = int.from_bytes(self.chunks[:4], "little") if len(self.chunks) >= 8 else 0
        binary = bytearray(self.chunks[8 : 8 + n_binary])
        self.rest = self.chunks[8 + n_binary :]
        self.buffers = [self._buffer(buffer, binary) for buffer in self.header.get("buffers", [])]

    def _buffer(self, buffer: dict[str, Any], binary: bytearray) -> bytearray:
        uri = buffer.get("uri")
        if uri is None:
            return binary
        if not str(uri).startswith("data:"):
            if self.fetch is not None:
                return bytearray(self.fetch(str(uri)))
            raise MeshError(f"its data are in another file, {uri}", "export it again as one GLB file")
        return bytearray(base64.b64decode(str(uri).partition(_DATA_URI)[2]))

    def array(self, accessor_id: int) -> NDArray[Any]:
        """The values of an accessor (n, width), in the buffer itself."""
        accessor = self.header["accessors"][accessor_id]
        view = self.header["bufferViews"][accessor["bufferView"]]
        dtype, width = np.dtype(_DTYPES[accessor["componentType"]]), _WIDTHS[accessor["type"]]
        offset = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        stride = view.get("byteStride", dtype.itemsize * width)
        buffer = self.buffers[view["buffer"]]
        shape = (int(accessor["count"]), width)
        if shape[0] < 0 or offset + stride * (shape[0] - 1) + dtype.itemsize * width > len(buffer):
            raise MeshError(f"accessor {accessor_id} reaches beyond its buffer", DAMAGED_HINT)
        return np.ndarray(shape, dtype, buffer=buffer, offset=offset, strides=(stride, dtype.itemsize))

    def parts(self) -> list[_Part]:
        """Every primitive wherever the scene has it: by meshes, then primitives, then nodes, in the file's order."""
        places = self._places()
        found: list[tuple[dict[str, int], NDArray[np.int64], list[Points]]] = []
        for mesh_id, mesh in enumerate(self.header.get("meshes", [])):
            for primitive in mesh["primitives"] if mesh_id in places else ():
                found.append((primitive["attributes"], self._faces(primitive), places[mesh_id]))
        if not found:
            raise MeshError("it holds no mesh", "check that the scene was exported with its meshes")
        # One mesh may be placed any number of times: a short file can ask for more than there is memory.
        check_memory(
            sum(len(self.array(attributes["POSITION"])) * len(where) for attributes, _, where in found),
            sum(len(faces) * len(where) for _, faces, where in found),
        )
        return [
            _Part(attributes, matrix, faces[:, [0, 2, 1]] if np.linalg.det(matrix[:3, :3]) < 0.0 else faces)
            for attributes, faces, where in found
            for matrix in where
        ]

    def _faces(self, primitive: dict[str, Any]) -> NDArray[np.int64]:
        if "indices" in primitive:
            ids = self.array(primitive["indices"])[:, 0].astype(np.int64)
        else:
            ids = np.arange(len(self.array(primitive["attributes"]["POSITION"])), dtype=np.int64)
        if primitive.get("mode", 4) != _TRIANGLE_STRIP:
            if len(ids) % 3:
                raise MeshError(f"a primitive has {len(ids)} corners, not a multiple of 3", DAMAGED_HINT)
            return ids.reshape(-1, 3)
        faces = np.column_stack([ids[:-2], ids[1:-1], ids[2:]])
        # As trimesh turns them, so that a scene has the same faces whichever of the two reads it.
        faces[1::2] = faces[1::2][:, ::-1]
        return faces

    def _places(self) -> dict[int, list[Points]]:
        """The matrices from mesh to world of every mesh."""
        nodes = self.header.get("nodes", [])
        scenes = self.header.get("scenes", [])
        children = {child for node in nodes for child in node.get("children", [])}
        roots = [i for i in range(len(nodes)) if i not in children]
        if scenes:
            roots = scenes[self.header.get("scene", 0)].get("nodes", [])
        placed: dict[int, Points] = {}
        waiting = [(root, np.eye(4)) for root in roots]
        while waiting:
            node_id, parent = waiting.pop()
            if node_id in placed:
                raise MeshError(f"node {node_id} is in its scene twice", DAMAGED_HINT)
            placed[node_id] = parent @ _matrix(nodes[node_id])
            waiting += [(child, placed[node_id]) for child in nodes[node_id].get("children", [])]
        places: dict[int, list[Points]] = {}
        for node_id in sorted(placed):
            if "mesh" in nodes[node_id]:
                if self.fetch is None:
                    _check_way_back(node_id, nodes[node_id], placed[node_id])
                places.setdefault(nodes[node_id]["mesh"], []).append(placed[node_id])
        return places

    def encode(self) -> bytes:
        """The whole file."""
        binary = b""
        for buffer, content in zip(self.header.get("buffers", []), self.buffers, strict=True):
            if "uri" in buffer:
                start = str(buffer["uri"]).partition(_DATA_URI)[0]
                buffer["uri"] = start + _DATA_URI + base64.b64encode(content).decode("ascii")
            else:
                binary = bytes(content)
        # Escaped, since a name may hold a lone surrogate, which UTF-8 has no bytes for.
        text = json.dumps(self.header, separators=(",", ":")).encode("ascii")
        text += b" " * (-len(text) % 4)
        chunks = self.chunks[:8] + binary + self.rest
        length = 20 + len(text) + len(chunks)
        return (
            b"glTF"
            + self.version
            + length.to_bytes(4, "little")
            + len(text).to_bytes(4, "little")
            + b"JSON"
            + text
            + chunks
        )


def _matrix(node: dict[str, Any]) -> Points:
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    x, y, z, w = np.array(node.get("rotation", [0.0, 0.0, 0.0, 1.0]), dtype=np.float64)
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * np.array(node.get("scale", [1.0, 1.0, 1.0]), dtype=np.float64)
    matrix[:3, 3] = node.get("translation", [0.0, 0.0, 0.0])
    return matrix


def _check_way_back(node_id: int, node: dict[str, Any], matrix: Points) -> None:
    """Checks that positions in the world can be brought back to where the file has them."""
    if not np.isfinite(matrix).all() or np.linalg.matrix_rank(matrix[:3, :3]) < 3:
        name = f" ('{node['name']}')" if "name" in node else ""
        raise MeshError(
            f"node {node_id}{name} makes its mesh flat: its matrix, with those above it, has no inverse, and the "
            "result cannot be written in its place",
            "give the node a scale other than 0, or name an output of another format, such as .ply",
        )


def read_glb_shape(data: bytes, fetch: Fetch | None = None) -> ParsedMesh:
    """Reads the triangles of a whole scene at their places, whatever their materials.

    Args:
        data: The whole file, which `check_glb` has let pass.
        fetch: Reads data that are in another file; by default they are refused, since they cannot be written again, and
            so are nodes that make their meshes flat.

    Returns:
        Positions, faces, and attributes ``_NAME`` that all primitives have.

    Raises:
        MeshError: There is no mesh, its data are elsewhere or not whole, or there is no way back to them.
    """
    glb = _Glb(data, fetch)
    parts = glb.parts()
    vertices, faces = _world(glb, parts)
    names = set.intersection(*({n for n in part.attributes if n.startswith("_")} for part in parts))
    attributes = {}
    for name in sorted(names):
        values = [glb.array(part.attributes[name]) for part in parts]
        if len({(v.shape[1], v.dtype.str) for v in values}) == 1:
            joined = np.concatenate(values)
            attributes[name] = joined[:, 0] if joined.shape[1] == 1 else joined
    return ParsedMesh(vertices, faces, vertex_attributes=attributes)


def _world(glb: _Glb, parts: list[_Part]) -> tuple[Points, NDArray[np.int64]]:
    vertices, faces, n_vertices = [], [], 0
    for part in parts:
        local = glb.array(part.attributes["POSITION"]).astype(np.float64)
        is_placed = not np.array_equal(part.matrix, np.eye(4))
        vertices.append(local @ part.matrix[:3, :3].T + part.matrix[:3, 3] if is_placed else local)
        faces.append(part.faces + n_vertices)
        n_vertices += len(local)
    return np.concatenate(vertices), np.concatenate(faces)


def rewrite_glb(data: bytes, motion: Motion) -> bytes:
    """Writes a scene again: positions and normals of its meshes change in place, with the bounds of the positions.

    A mesh that stands at several places gets the mean of what they became.

    Args:
        data: The whole file.
        motion: From the positions that `read_glb_shape` returns.

    Returns:
        The whole file; its JSON has the same values, but for those bounds.
    """
    glb = _Glb(data)
    parts = glb.parts()
    has_moved = (motion.before != motion.after).any(axis=1)
    sums: dict[int, Points] = {}
    counts: dict[int, NDArray[np.int64]] = {}
    starts = np.cumsum([0, *(len(glb.array(part.attributes["POSITION"])) for part in parts)]).tolist()
    for part, start, end in zip(parts, starts[:-1], starts[1:], strict=True):
        accessor_id = part.attributes["POSITION"]
        back = np.linalg.inv(part.matrix[:3, :3])
        local = (motion.after[start:end] - part.matrix[:3, 3]) @ back.T
        moved = has_moved[start:end]
        total = sums.setdefault(accessor_id, np.zeros_like(local))
        count = counts.setdefault(accessor_id, np.zeros(len(local), dtype=np.int64))
        total[moved] += local[moved]
        count[moved] += 1
    for accessor_id, total in sums.items():
        rows, moved = glb.array(accessor_id), counts[accessor_id] > 0
        rows[moved] = total[moved] / counts[accessor_id][moved, None]
        accessor = glb.header["accessors"][accessor_id]
        for bound, values in (("min", rows.min(axis=0)), ("max", rows.max(axis=0))):
            if moved.any() and bound in accessor:
                accessor[bound] = values.astype(np.float64).tolist()
    _renew_normals(glb, parts, starts, motion)
    return glb.encode()


def _renew_normals(glb: _Glb, parts: list[_Part], starts: list[int], motion: Motion) -> None:
    """Over all parts at once, so that a smooth surface of several materials stays smooth."""
    old = np.zeros((len(motion.before), 3))
    for part, start, end in zip(parts, starts[:-1], starts[1:], strict=True):
        if "NORMAL" in part.attributes:
            world = glb.array(part.attributes["NORMAL"]).astype(np.float64) @ np.linalg.inv(
                part.matrix[:3, :3]
            )
            old[start:end] = world
    new = motion.vertex_normals(old)
    for part, start, end in zip(parts, starts[:-1], starts[1:], strict=True):
        changed = (new[start:end] != old[start:end]).any(axis=1)
        if "NORMAL" in part.attributes and changed.any():
            local = new[start:end][changed] @ part.matrix[:3, :3]
            local /= np.linalg.norm(local, axis=1, keepdims=True)
            glb.array(part.attributes["NORMAL"])[changed] = local

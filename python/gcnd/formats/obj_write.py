"""Wavefront OBJ, writing."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from gcnd.formats.parsed import ParsedMesh

__all__ = ["write_obj"]


def write_obj(mesh: ParsedMesh, material_names: Sequence[str] = ()) -> bytes:
    """Writes an OBJ file whose numbers read back exactly, without normals.

    Args:
        mesh: The mesh. `material_libraries` are named in it; other attributes are not written.
        material_names: Names that `face_attributes["material_id"]` indexes (−1 for none); a single name
            without that attribute holds for all faces.

    Returns:
        The whole file.
    """
    lines = [f"mtllib {library}" for library in mesh.material_libraries]
    if mesh.metadata.get("name"):
        lines.append(f"o {str(mesh.metadata['name']).splitlines()[0]}")
    rows: list[list[float]] = mesh.vertices.tolist()
    if mesh.vertex_colors is None:
        lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in rows]
    else:
        # Nine digits after the point bring every channel of 8 bits back.
        colors = (mesh.vertex_colors[:, :3] / 255.0).tolist()
        lines += [
            f"v {x!r} {y!r} {z!r} {r:.9g} {g:.9g} {b:.9g}"
            for (x, y, z), (r, g, b) in zip(rows, colors, strict=True)
        ]
    if mesh.uv is not None:
        lines += [f"vt {u!r} {v!r}" for u, v in mesh.uv.tolist()]
    faces: list[list[int]] = (mesh.faces + 1).tolist()
    corner = "f {0}/{0} {1}/{1} {2}/{2}" if mesh.uv is not None else "f {} {} {}"
    no_material = np.full(len(faces), 0 if len(material_names) == 1 else -1)
    material_ids = mesh.face_attributes.get("material_id", no_material).tolist()
    for material_id, run in groupby(range(len(faces)), key=material_ids.__getitem__):
        if 0 <= material_id < len(material_names):
            lines.append(f"usemtl {material_names[material_id]}")
        lines += [corner.format(*faces[face_id]) for face_id in run]
    return ("\n".join(lines) + "\n").encode("utf-8", errors="replace")

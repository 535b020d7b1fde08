"""From a scene of several placed meshes to one mesh, if nothing is lost by it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gcnd.errors import MeshError
from gcnd.formats.parsed import ParsedMesh, rgba_from_values
from gcnd.memory import check_memory

if TYPE_CHECKING:
    import trimesh

__all__ = ["merge_scene"]

_PARTS = ("vertices", "faces")

_SPLIT_HINT = "join the parts to one mesh with one material, or write each to its own file"


def merge_scene(scene: trimesh.Scene) -> tuple[ParsedMesh, Any]:
    """Places every mesh of a scene where the scene puts it and takes them together, in the file's order.

    Args:
        scene: The scene.

    Returns:
        The mesh, and the one material that all its parts share, or None.

    Raises:
        MeshError: If the scene has no mesh, or its parts differ in material, colours or attributes, so that
            one mesh could not hold them.
    """
    parts: list[tuple[str, Any, ParsedMesh]] = []
    # trimesh walks a file's nodes from the last to the first; its meshes are in the file's order.
    placements = [scene.graph[node] for node in reversed(scene.graph.nodes_geometry)]
    mesh_order = list(scene.geometry)
    # One mesh may be placed any number of times: a short file can ask for more than there is memory.
    check_memory(
        *(sum(len(getattr(scene.geometry[name], part, ())) for _, name in placements) for part in _PARTS)
    )
    for transform, name in sorted(placements, key=lambda placement: mesh_order.index(placement[1])):
        geometry = scene.geometry[name]
        if not hasattr(geometry, "faces"):
            raise MeshError(f"part '{name}' is no triangle mesh", _SPLIT_HINT)
        parts.append((str(name), geometry.visual, _placed(geometry, np.asarray(transform, dtype=np.float64))))
    if not parts:
        raise MeshError("it holds no mesh", "check that the scene was exported with its meshes")
    first_name, first_visual, first = parts[0]
    for name, visual, part in parts[1:]:
        difference = _difference(first_visual, first, visual, part)
        if difference:
            raise MeshError(
                f"it holds {len(parts)} meshes that do not fit into one: '{first_name}' and '{name}' have "
                f"different {difference}",
                _SPLIT_HINT,
            )
    merged = _concatenate([part for _, _, part in parts]) if len(parts) > 1 else first
    return merged, getattr(first_visual, "material", None)


def _placed(geometry: Any, transform: NDArray[np.float64]) -> ParsedMesh:
    """The geometry as arrays, moved by the transform in 64 bits."""
    vertices = np.array(geometry.vertices, dtype=np.float64)
    faces = np.array(geometry.faces, dtype=np.int64)
    if not np.array_equal(transform, np.eye(4)):
        vertices = vertices @ transform[:3, :3].T + transform[:3, 3]
        if np.linalg.det(transform[:3, :3]) < 0.0:
            # A mirroring turns every face inside out; the first corner stays first.
            faces = faces[:, [0, 2, 1]]
    visual = geometry.visual
    is_texture = visual.kind == "texture"
    colors = visual.vertex_attributes.get("color") if is_texture else None
    if visual.kind == "vertex":
        colors = visual.vertex_colors
    return ParsedMesh(
        vertices=vertices,
        faces=faces,
        vertex_colors=None if colors is None else rgba_from_values(np.asarray(colors)),
        face_colors=np.array(visual.face_colors) if visual.kind == "face" else None,
        uv=np.array(visual.uv, dtype=np.float64) if is_texture and visual.uv is not None else None,
        vertex_attributes={k: np.asarray(v) for k, v in geometry.vertex_attributes.items()},
        face_attributes={k: np.asarray(v) for k, v in geometry.face_attributes.items()},
        metadata=dict(geometry.metadata),
    )


def _difference(visual_a: Any, a: ParsedMesh, visual_b: Any, b: ParsedMesh) -> str | None:
    """What keeps two parts from becoming one mesh, in words."""
    material_a, material_b = getattr(visual_a, "material", None), getattr(visual_b, "material", None)
    if (material_a is None) != (material_b is None) or (
        material_a is not material_b and hash(material_a) != hash(material_b)
    ):
        return "materials"
    for name in ("vertex_colors", "face_colors", "uv"):
        if (getattr(a, name) is None) != (getattr(b, name) is None):
            return {"uv": "texture coordinates"}.get(name, "colours")
    for of_a, of_b in ((a.vertex_attributes, b.vertex_attributes), (a.face_attributes, b.face_attributes)):
        signature_a = {k: (v.dtype, v.shape[1:]) for k, v in of_a.items()}
        if signature_a != {k: (v.dtype, v.shape[1:]) for k, v in of_b.items()}:
            return "attributes"
    return None


def _concatenate(parts: list[ParsedMesh]) -> ParsedMesh:
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    first = parts[0]

    def stacked(name: str) -> Any:
        rows = [getattr(part, name) for part in parts]
        return None if rows[0] is None else np.concatenate(rows)

    def stacked_attributes(name: str) -> dict[str, NDArray[Any]]:
        return {key: np.concatenate([getattr(p, name)[key] for p in parts]) for key in getattr(first, name)}

    return ParsedMesh(
        vertices=stacked("vertices"),
        faces=np.concatenate([p.faces + start for p, start in zip(parts, starts[:-1], strict=True)]),
        vertex_colors=stacked("vertex_colors"),
        face_colors=stacked("face_colors"),
        uv=stacked("uv"),
        vertex_attributes=stacked_attributes("vertex_attributes"),
        face_attributes=stacked_attributes("face_attributes"),
        metadata={k: v for part in reversed(parts) for k, v in part.metadata.items()},
    )

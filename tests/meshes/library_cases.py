"""Meshes of other libraries with all that such a mesh can hold, and what there is to see of one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import trimesh

from gcnd.data.noise import add_noise

BALL = trimesh.creation.icosphere(subdivisions=2)
FACES = np.array(BALL.faces)
VERTICES = add_noise(np.array(BALL.vertices), FACES.astype(np.uint32), level=0.3, seed=1)
KEEP = np.arange(len(VERTICES)) % 3 == 0
RNG = np.random.default_rng(0)
UV = RNG.random((len(VERTICES), 2))
COLORS = RNG.integers(0, 256, (len(VERTICES), 3), dtype=np.uint8)
LABELS = RNG.integers(0, 9, len(FACES))


def old_normals() -> np.ndarray:
    return np.array(trimesh.Trimesh(VERTICES, FACES, process=False).vertex_normals)


def expected_normals(vertices: Any, faces: Any = FACES) -> np.ndarray:
    """An independent loop over the faces."""
    sums = np.zeros((len(vertices), 3))
    for face in np.asarray(faces):
        a, b, c = np.asarray(vertices, dtype=np.float64)[face]
        for corner in face:
            sums[corner] += np.cross(b - a, c - a)
    return np.array([n / np.linalg.norm(n) for n in sums])


def poly_data(dtype: Any = np.float32) -> Any:
    pyvista = pytest.importorskip("pyvista")
    mesh = pyvista.PolyData.from_regular_faces(VERTICES.astype(dtype), FACES)
    mesh.point_data["region"] = KEEP.astype(np.uint8)
    mesh.point_data["heat"] = UV[:, 0]
    mesh.point_data["RGB"] = COLORS
    mesh.cell_data["label"] = LABELS
    mesh.field_data["unit"] = ["mm"]
    mesh.user_dict["who"] = "a scanner"
    mesh.active_texture_coordinates = UV
    mesh.point_data.active_normals = old_normals().astype(np.float32)
    mesh.set_active_scalars("heat")
    return mesh


def legacy_mesh() -> Any:
    open3d = pytest.importorskip("open3d")
    mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(VERTICES), open3d.utility.Vector3iVector(FACES)
    )
    mesh.vertex_colors = open3d.utility.Vector3dVector(COLORS / 255.0)
    mesh.triangle_uvs = open3d.utility.Vector2dVector(UV[FACES.ravel()])
    mesh.triangle_material_ids = open3d.utility.IntVector(LABELS.astype(np.int32))
    mesh.textures = [open3d.geometry.Image(np.full((2, 2, 3), 7, dtype=np.uint8))]
    mesh.vertex_normals = open3d.utility.Vector3dVector(old_normals())
    mesh.compute_triangle_normals()
    return mesh


def tensor_mesh(dtype: Any = np.float32, index: Any = np.int32) -> Any:
    open3d = pytest.importorskip("open3d")
    mesh = open3d.t.geometry.TriangleMesh()
    tensor: Any = open3d.core.Tensor
    mesh.vertex["positions"], mesh.triangle["indices"] = (
        tensor(VERTICES.astype(dtype)),
        tensor(FACES.astype(index)),
    )
    mesh.vertex["normals"] = tensor(old_normals().astype(dtype))
    mesh.vertex["region"] = tensor(KEEP.astype(np.uint8).reshape(-1, 1))
    mesh.vertex["colors"] = tensor(COLORS)
    mesh.triangle["label"] = tensor(LABELS.reshape(-1, 1))
    mesh.triangle["texture_uvs"] = tensor(UV[FACES].astype(np.float32))
    mesh.material.material_name = "defaultLit"
    mesh.material.texture_maps["albedo"] = open3d.t.geometry.Image(np.full((2, 2, 3), 7, dtype=np.uint8))
    return mesh


def meshio_mesh(dtype: Any = np.float64) -> Any:
    meshio = pytest.importorskip("meshio")
    return meshio.Mesh(
        VERTICES.astype(dtype),
        [("triangle", FACES[:100]), ("line", np.array([[0, 1], [1, 2]])), ("triangle", FACES[100:])],
        point_data={"region": KEEP.astype(np.int8), "Normals": old_normals(), "uv": UV},
        cell_data={"label": [LABELS[:100], np.array([5, 6]), LABELS[100:]]},
        field_data={"patch": np.array([1, 2])},
        point_sets={"rim": np.array([3, 4])},
        cell_sets={"half": [np.arange(50), np.array([]), np.array([])]},
        info={"unit": "mm"},
    )


def snapshot(mesh: Any) -> dict[str, Any]:
    """All that a mesh holds, as arrays and texts by name, in the order that the library has them in."""
    match type(mesh).__module__.partition(".")[0]:
        case "pyvista":
            found: dict[str, Any] = {"points": np.array(mesh.points), "faces": np.array(mesh.faces)}
            for name in ("point_data", "cell_data", "field_data"):
                data = getattr(mesh, name)
                found |= {f"{name} {key}": np.array(data[key]) for key in data.keys()}  # noqa: SIM118
            found["field_data _PYVISTA_USER_DICT"] = dict(mesh.user_dict)
            found["active"] = (mesh.active_scalars_name, mesh.point_data.active_texture_coordinates_name)
            found["active normals"] = mesh.point_data.active_normals_name
            return found
        case "meshio":
            found = {"points": mesh.points.copy(), "info": dict(mesh.info), "sets": repr(mesh.cell_sets)}
            found |= {f"block {i} {b.type}": b.data.copy() for i, b in enumerate(mesh.cells)}
            found |= {f"point {name}": np.array(v) for name, v in mesh.point_data.items()}
            found |= {f"cell {name} {i}": v for name, vs in mesh.cell_data.items() for i, v in enumerate(vs)}
            found |= {f"field {name}": np.array(v) for name, v in mesh.field_data.items()}
            return found | {f"set {name}": np.array(v) for name, v in mesh.point_sets.items()}
    if hasattr(mesh, "vertex"):
        found = {f"vertex {name}": mesh.vertex[name].numpy().copy() for name in mesh.vertex}
        found |= {f"triangle {name}": mesh.triangle[name].numpy().copy() for name in mesh.triangle}
        maps = mesh.material.texture_maps
        found |= {f"texture {name}": maps[name].as_tensor().numpy().copy() for name in maps}
        return found | {"material": mesh.material.material_name}
    names = ("vertices", "triangles", "vertex_colors", "triangle_uvs", "triangle_material_ids")
    found = {name: np.array(getattr(mesh, name)) for name in (*names, "vertex_normals", "triangle_normals")}
    return found | {f"texture {i}": np.asarray(image).copy() for i, image in enumerate(mesh.textures)}


CASES = {
    "pyvista": (poly_data, "points", "point_data Normals"),
    "pyvista-64": (lambda: poly_data(np.float64), "points", "point_data Normals"),
    "open3d": (legacy_mesh, "vertices", "vertex_normals"),
    "open3d-tensor": (tensor_mesh, "vertex positions", "vertex normals"),
    "open3d-tensor-64": (lambda: tensor_mesh(np.float64, np.int64), "vertex positions", "vertex normals"),
    "meshio": (meshio_mesh, "points", "point Normals"),
    "meshio-32": (lambda: meshio_mesh(np.float32), "points", "point Normals"),
}
all_kinds = pytest.mark.parametrize("kind", CASES)


def same(a: Any, b: Any) -> bool:
    if not isinstance(a, np.ndarray):
        return bool(a == b)
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()

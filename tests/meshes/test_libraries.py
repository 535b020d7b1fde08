"""Other libraries' meshes: the real ones, taken and returned with all that is not geometry."""

from __future__ import annotations

import itertools
import pickle
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
import trimesh

from gcnd import Controls, Denoiser, denoise
from gcnd.data.noise import add_noise
from gcnd.errors import ConfigError, MeshError
from gcnd.filters import apply_filter
from gcnd.mesh_io import to_arrays
from gcnd.viewer.view import view

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


@all_kinds
def test_only_positions_and_normals_change(kind: str) -> None:
    make, positions, normals = CASES[kind]
    mesh = make()
    before = snapshot(mesh)
    result = apply_filter(mesh, "taubin")
    assert type(result) is type(mesh)
    after = snapshot(result)
    assert set(after) == set(before)
    changed = {name for name in before if not same(before[name], after[name])}
    assert changed == {positions, normals} | ({"triangle_normals"} if kind == "open3d" else set())
    expected, _ = apply_filter((before[positions], FACES), "taubin")
    assert same(after[positions], expected)
    assert np.abs(after[normals] - expected_normals(expected)).max() < 1e-6
    assert after[normals].dtype == before[normals].dtype
    assert all(same(value, before[name]) for name, value in snapshot(mesh).items()), "the input was modified"


@all_kinds
def test_no_strength_keeps_every_bit(kind: str) -> None:
    mesh = CASES[kind][0]()
    before, after = snapshot(mesh), snapshot(apply_filter(mesh, "taubin", controls=Controls(strength=0.0)))
    assert [name for name in before if not same(before[name], after[name])] == []


@all_kinds
def test_results_share_nothing_with_the_input(kind: str) -> None:
    make, positions, _ = CASES[kind]
    mesh = make()
    before = snapshot(mesh)
    arrays, rebuild = to_arrays(mesh)
    arrays.vertices[:] = 7.0
    arrays.faces[:] = 0
    result = rebuild(arrays.vertices + 1.0)
    if kind.startswith("pyvista"):
        result.point_data["heat"][:] = -1.0
        result.cell_data["label"][:] = -1
        result.points[:] = -1.0
    elif kind.startswith("meshio"):
        result.points[:], result.cells[0].data[:] = -1.0, 0
        result.point_data["uv"][:], result.cell_data["label"][0][:] = -1.0, -1
    elif kind == "open3d":
        np.asarray(result.vertices)[:] = -1.0
        np.asarray(result.triangle_uvs)[:] = -1.0
    else:
        result.vertex["positions"][:] = -1.0
        result.vertex["colors"][:] = 0
        result.triangle["label"][:] = 0
    assert all(same(value, before[name]) for name, value in snapshot(mesh).items())
    assert not same(snapshot(result)[positions], before[positions])


@all_kinds
def test_the_network_takes_and_returns_it(kind: str) -> None:
    make, positions, _ = CASES[kind]
    mesh = make()
    result = denoise(mesh, preset="fast", vertex_iterations=2)
    expected, _ = Denoiser("fast", vertex_iterations=2)((snapshot(mesh)[positions], FACES))
    assert type(result) is type(mesh)
    assert np.abs(snapshot(result)[positions] - expected).max() < 1e-6
    assert np.abs(expected - VERTICES).max() > 1e-3


@pytest.mark.parametrize("kind", [kind for kind in CASES if kind != "open3d"])
def test_vertices_are_kept_by_the_name_of_an_attribute(kind: str) -> None:
    make, positions, _ = CASES[kind]
    mesh = make()
    before = snapshot(mesh)[positions]
    after = snapshot(apply_filter(mesh, "taubin", controls=Controls(keep="region")))[positions]
    assert same(after[KEEP], before[KEEP])
    assert (after[~KEEP] != before[~KEEP]).any(axis=1).all()
    with pytest.raises(ConfigError, match="no vertex attribute 'absent'") as error:
        apply_filter(mesh, "taubin", controls=Controls(keep="absent"))
    assert "region" in str(error.value.hint)


def test_a_mesh_without_attributes_says_so() -> None:
    with pytest.raises(ConfigError, match="no vertex attribute 'region'"):
        apply_filter(legacy_mesh(), "taubin", controls=Controls(keep="region"))
    mask = apply_filter(legacy_mesh(), "taubin", controls=Controls(keep=KEEP))
    assert same(np.array(mask.vertices)[KEEP], VERTICES[KEEP])


@all_kinds
def test_it_can_be_viewed(kind: str, tmp_path: Any) -> None:
    mesh = CASES[kind][0]()
    figures = view(apply_filter(mesh, "taubin"), against=mesh, out=tmp_path / "view.html")
    assert figures.displacement_max > 0.05
    assert (tmp_path / "view.html").stat().st_size > 100_000


# --- faces of four corners and more ------------------------------------------------------------------

SIDE = 9
GRID = np.array([[x, y, 0.3 * np.sin(x)] for y in range(SIDE) for x in range(SIDE)], dtype=np.float64)
GRID[:, 2] += 0.1 * RNG.standard_normal(len(GRID))
QUADS = np.array(
    [
        [c, c + 1, c + SIDE + 1, c + SIDE]
        for y in range(SIDE - 1)
        for c in range(y * SIDE, y * SIDE + SIDE - 1)
    ]
)
PENTAGON = [80, 79, 78, 69, 70]


def poly_data_of_quads() -> Any:
    """Quads, the last of them cut into two triangles, in 32 bits and with normals of points and cells."""
    pyvista = pytest.importorskip("pyvista")
    *rows, (a, b, c, d) = QUADS.tolist()
    faces = [*rows, [a, b, c], [a, c, d]]
    cells = np.concatenate([[len(row), *row] for row in faces])
    mesh = pyvista.PolyData(GRID.astype(np.float32), faces=cells)
    mesh.cell_data["label"] = np.arange(len(faces))
    return mesh.compute_normals(cell_normals=True, split_vertices=False, consistent_normals=False)


def meshio_mesh_of_quads() -> Any:
    meshio = pytest.importorskip("meshio")
    a, b, c, d = QUADS[-1]
    return meshio.Mesh(
        GRID,
        [
            ("quad", QUADS[:20]),
            ("line", np.array([[0, 1]])),
            ("triangle", np.array([[a, b, c], [a, c, d]])),
            ("quad", QUADS[20:-1]),
        ],
        point_data={"Normals": np.tile([0.0, 0.0, 1.0], (len(GRID), 1))},
        cell_data={"label": [np.arange(20), np.array([7]), np.array([8, 9]), np.arange(43)]},
        info={"unit": "mm"},
    )


def corners_of(mesh: Any) -> list[list[int]]:
    """The faces of either mesh, corner by corner, in their order."""
    if hasattr(mesh, "cells"):
        return [list(map(int, row)) for block in mesh.cells if block.type != "line" for row in block.data]
    offsets = np.array(mesh.GetPolys().GetOffsetsArray())
    ids = np.array(mesh.GetPolys().GetConnectivityArray()).tolist()
    return [ids[i:j] for i, j in itertools.pairwise(offsets)]


@pytest.mark.parametrize("make", [poly_data_of_quads, meshio_mesh_of_quads])
def test_quads_are_split_for_the_work_and_come_back_whole(make: Any) -> None:
    mesh = make()
    faces, before = corners_of(mesh), snapshot(mesh)
    points = np.array(mesh.points)
    with pytest.raises(MeshError) as error:
        to_arrays(mesh)
    assert "triangulate=True" in str(error.value.hint)
    arrays, _ = to_arrays(mesh, triangulate=True)
    assert len(arrays.faces) == 2 * len(QUADS)
    result = apply_filter(mesh, "taubin", triangulate=True)
    assert type(result) is type(mesh)
    assert corners_of(result) == faces
    # The same as of the same triangles, and of the same faces in lists.
    expected, _ = apply_filter((points, arrays.faces), "taubin")
    assert same(np.array(result.points), expected)
    assert same(apply_filter((points, faces), "taubin", triangulate=True)[0], expected)
    after = snapshot(result)
    assert set(after) == set(before)
    normals = {name for name in before if "Normals" in name}
    changed = {name for name in before if not same(before[name], after[name])}
    assert changed == {"points"} | normals
    for name in normals:
        if "cell" not in name:
            assert np.abs(after[name] - expected_normals(expected, arrays.faces)).max() < 1e-6
    assert all(same(value, before[name]) for name, value in snapshot(mesh).items()), "the input was modified"


def test_normals_of_quads_in_a_poly_data_are_those_of_their_halves() -> None:
    mesh = poly_data_of_quads()
    mesh.cell_data.active_normals_name = "Normals"
    result = apply_filter(mesh, "taubin", triangulate=True)
    arrays, _ = to_arrays(mesh, triangulate=True)
    sums = np.zeros((mesh.n_cells, 3))
    owner = [i for i, row in enumerate(corners_of(mesh)) for _ in row[2:]]
    for face_id, (a, b, c) in zip(
        owner, np.array(result.points, dtype=np.float64)[arrays.faces], strict=True
    ):
        sums[face_id] += np.cross(b - a, c - a)
    wanted = sums / np.linalg.norm(sums, axis=1, keepdims=True)
    assert np.abs(np.array(result.cell_data["Normals"]) - wanted).max() < 1e-6


def test_denoise_takes_quads_too() -> None:
    mesh = poly_data_of_quads()
    result = denoise(mesh, preset="fast", triangulate=True)
    assert corners_of(result) == corners_of(mesh)
    assert np.abs(np.array(result.points) - np.array(mesh.points)).max() > 1e-3


def test_polygons_that_are_none_are_named() -> None:
    meshio = pytest.importorskip("meshio")
    pyvista = pytest.importorskip("pyvista")
    mesh = meshio.Mesh(GRID, [("quad", QUADS[:3]), ("polygon", np.array([PENTAGON]))])
    assert len(to_arrays(mesh, triangulate=True)[0].faces) == 2 * 3 + 3
    with pytest.raises(MeshError, match="face 1 refers to vertex 99"):
        to_arrays(meshio.Mesh(GRID, [("quad", [QUADS[0], [0, 1, 99, 2]])]), triangulate=True)
    with pytest.raises(MeshError, match="face 3 has 2 corners"):
        to_arrays(meshio.Mesh(GRID, [("quad", QUADS[:3]), ("polygon", np.array([[0, 1]]))]), triangulate=True)
    with pytest.raises(MeshError, match="cells other than triangles: tetra"):
        to_arrays(meshio.Mesh(GRID, [("quad", QUADS), ("tetra", QUADS[:1])]), triangulate=True)
    with pytest.raises(MeshError, match="face 1 of the PolyData has 2 corners") as error:
        to_arrays(pyvista.PolyData(GRID, faces=[4, *QUADS[0], 2, 0, 1]), triangulate=True)
    assert "damaged" in str(error.value.hint)
    with pytest.raises(MeshError, match="no faces"):
        to_arrays(pyvista.PolyData(), triangulate=True)


# --- what is no mesh of triangles --------------------------------------------------------------------


def test_other_cells_of_a_poly_data_are_refused() -> None:
    pyvista = pytest.importorskip("pyvista")
    quads = pyvista.Plane(i_resolution=2, j_resolution=2)
    mixed = pyvista.PolyData(quads.points, faces=[3, 0, 1, 3, 4, 1, 2, 5, 4])
    strips = pyvista.Sphere(theta_resolution=8, phi_resolution=8).strip()
    lines = pyvista.PolyData(VERTICES, faces=poly_data().faces, lines=[2, 0, 1])
    for mesh, message in [
        (quads, "face 0 of the PolyData has 4 corners, not 3"),
        (mixed, "face 1 of the PolyData has 4 corners, not 3"),
        (strips, "the PolyData has [0-9]+ triangle strips"),
        (lines, "the PolyData has 0 vertex cells and 1 lines beside"),
        (pyvista.PolyData(VERTICES), f"the PolyData has {len(VERTICES)} vertex cells"),
    ]:
        with pytest.raises(MeshError, match=message) as error:
            to_arrays(mesh)
        is_polygonal = any(mesh is other for other in (quads, mixed, strips))
        assert ("mesh.triangulate()" if is_polygonal else "faces=mesh.faces") in str(error.value.hint)
    # The hints hold.
    for mesh in (quads, mixed, strips):
        assert len(to_arrays(mesh.triangulate())[0].faces) > 2
    assert len(to_arrays(pyvista.PolyData(lines.points, faces=lines.faces))[0].faces) == len(FACES)
    with pytest.raises(MeshError, match="no faces"):
        to_arrays(pyvista.PolyData())
    with pytest.raises(MeshError, match=r"cannot take a mesh from pyvista.*UnstructuredGrid") as error:
        to_arrays(quads.cast_to_unstructured_grid())
    assert "extract_surface().triangulate()" in str(error.value.hint)


def test_other_blocks_of_meshio_are_refused() -> None:
    meshio = pytest.importorskip("meshio")
    mesh = meshio_mesh()
    mesh.cells += [
        meshio.CellBlock("tetra", np.array([[0, 1, 2, 3]])),
        meshio.CellBlock("quad", [[0, 1, 2, 3]]),
    ]
    with pytest.raises(MeshError, match="cells other than triangles: quad, tetra") as error:
        to_arrays(mesh)
    assert "get_cells_type('triangle')" in str(error.value.hint)
    with pytest.raises(MeshError, match="no faces"):
        to_arrays(meshio.Mesh(VERTICES, [("line", np.array([[0, 1]]))]))
    with pytest.raises(MeshError, match=r"vertices have shape \(162, 2\)"):
        to_arrays(meshio.Mesh(VERTICES[:, :2], [("triangle", FACES)]))


def test_other_things_of_open3d_are_refused() -> None:
    open3d = pytest.importorskip("open3d")
    with pytest.raises(MeshError, match=r"cannot take a mesh from open3d.*PointCloud"):
        to_arrays(open3d.geometry.PointCloud())
    for empty in (open3d.geometry.TriangleMesh(), open3d.t.geometry.TriangleMesh()):
        with pytest.raises(MeshError, match="no faces"):
            to_arrays(empty)


# --- normals, and what is imported -------------------------------------------------------------------


def test_a_seam_stays_smooth_and_a_sharp_edge_stays_sharp() -> None:
    pyvista = pytest.importorskip("pyvista")
    # Two faces at an edge, each with vertices of its own: as a seam (equal normals), or as a crease.
    points = np.array([[0, 0, 0], [0, 1, 0], [-1, 0, 0.0], [0, 0, 0], [0, 1, 0], [1, 0, 0]])
    faces = np.array([[0, 1, 2], [3, 5, 4]])
    moved = points + np.array([[0, 0, 0], [0, 0, 0], [0, 0, -1], [0, 0, 0], [0, 0, 0], [0, 0, -1.0]])
    for is_seam in (True, False):
        mesh = pyvista.PolyData.from_regular_faces(points, faces)
        tilt = 0.0 if is_seam else 0.1
        normals = np.array([[-tilt, 0, 1], [-tilt, 0, 1], [0, 0, 1], [tilt, 0, 1], [tilt, 0, 1], [0, 0, 1]])
        mesh.point_data.active_normals = normals
        new = to_arrays(mesh)[1](moved).point_data.active_normals
        left, right = np.array([-1, 0, 1]) / np.sqrt(2), np.array([1, 0, 1]) / np.sqrt(2)
        expected = [[0, 0, 1], [0, 0, 1]] if is_seam else [left, right]
        assert np.allclose(new[[0, 3]], expected)
        assert np.allclose(new[[2, 5]], [left, right])


def test_normals_by_axis_and_of_a_class_derived() -> None:
    meshio = pytest.importorskip("meshio")

    class Scan(meshio.Mesh):  # type: ignore[misc, name-defined]
        pass

    columns = dict(zip(("nx", "ny", "nz"), old_normals().T.astype(np.float32), strict=True))
    mesh = Scan(VERTICES, [("triangle", FACES)], point_data={**columns, "normals": LABELS[: len(VERTICES)]})
    result = apply_filter(mesh, "taubin")
    assert type(result) is Scan
    found = np.column_stack([result.point_data[name] for name in columns])
    assert found.dtype == np.float32
    assert np.abs(found - expected_normals(result.points)).max() < 1e-6
    assert np.array_equal(result.point_data["normals"], LABELS[: len(VERTICES)])


def test_no_library_is_imported_for_another() -> None:
    # trimesh itself imports meshio where it is installed.
    code = (
        "import pickle, sys, numpy as np; from gcnd.filters import apply_filter;"
        "mesh = pickle.loads(sys.stdin.buffer.read()); apply_filter(mesh, 'taubin');"
        "print([name for name in ('pyvista', 'vtk', 'open3d', 'torch') if name in sys.modules])"
    )
    pair = pickle.dumps((VERTICES, FACES))
    done = subprocess.run([sys.executable, "-c", code], input=pair, capture_output=True, check=True)
    assert done.stdout.decode().strip() == "[]"

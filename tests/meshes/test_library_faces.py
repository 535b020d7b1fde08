"""Other libraries' meshes whose faces are not triangles alone: polygons come back whole, the rest is refused."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from library_cases import FACES, RNG, VERTICES, expected_normals, meshio_mesh, poly_data, same, snapshot

from gcnd import denoise
from gcnd.errors import MeshError
from gcnd.filters import apply_filter
from gcnd.mesh_io import to_arrays

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

"""Meshes in and out: kinds of mesh, what is kept, and every error that names its cause."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from gcnd.errors import GcndError, MeshError
from gcnd.formats.atomic import write_atomic
from gcnd.mesh_io import SUPPORTED, check_output_path, load, save, to_arrays

VERTICES = np.array([[0.1, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [7.0, 7.0, 7.0]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
"""A tetrahedron and one vertex (4) that no face uses."""


def colored_mesh() -> trimesh.Trimesh:
    mesh = trimesh.Trimesh(VERTICES, FACES, process=False)
    mesh.visual.vertex_colors = np.arange(20, dtype=np.uint8).reshape(5, 4) + 100
    mesh.vertex_attributes["quality"] = np.linspace(0, 1, 5).astype(np.float32)
    mesh.face_attributes["label"] = np.array([3, 1, 4, 1], dtype=np.int32)
    mesh.metadata["name"] = "tetra"
    return mesh


def textured_mesh() -> trimesh.Trimesh:
    mesh = trimesh.Trimesh(VERTICES, FACES, process=False)
    material = trimesh.visual.material.SimpleMaterial(diffuse=[200, 10, 20, 255])
    mesh.visual = trimesh.visual.TextureVisuals(uv=np.linspace(0, 1, 10).reshape(5, 2), material=material)
    mesh.visual.vertex_attributes["color"] = np.full((5, 4), 9, dtype=np.uint8)
    return mesh


# --- to_arrays ---------------------------------------------------------------------------------------


def test_arrays_have_the_core_types() -> None:
    arrays, _ = to_arrays((np.asfortranarray(VERTICES.astype(np.float32)), np.asfortranarray(FACES)))
    assert arrays.vertices.dtype == np.float64
    assert arrays.faces.dtype == np.uint32
    assert arrays.vertices.flags.c_contiguous
    assert arrays.faces.flags.c_contiguous
    assert np.array_equal(arrays.faces, FACES)


def test_trimesh_comes_back_with_everything_but_stale_normals() -> None:
    mesh = colored_mesh()
    mesh.units = "mm"
    mesh.vertex_attributes["nx"] = np.ones(5)
    normals_before = mesh.vertex_normals.copy()
    arrays, rebuild = to_arrays(mesh)
    moved = rebuild(arrays.vertices * [1.0, 2.0, 3.0])
    assert type(moved) is trimesh.Trimesh
    assert np.array_equal(moved.vertices, VERTICES * [1.0, 2.0, 3.0])
    assert np.array_equal(moved.faces, FACES)
    assert np.array_equal(moved.visual.vertex_colors, mesh.visual.vertex_colors)
    assert np.array_equal(moved.vertex_attributes["quality"], mesh.vertex_attributes["quality"])
    assert np.array_equal(moved.face_attributes["label"], mesh.face_attributes["label"])
    assert moved.metadata == mesh.metadata
    assert moved.units == "mm"
    assert "nx" not in moved.vertex_attributes
    fresh = trimesh.Trimesh(moved.vertices, FACES, process=False)
    assert np.allclose(moved.vertex_normals, fresh.vertex_normals)
    assert not np.allclose(moved.vertex_normals, normals_before)


def test_input_is_not_changed_and_shares_no_memory() -> None:
    mesh = colored_mesh()
    arrays, rebuild = to_arrays(mesh)
    new_vertices = arrays.vertices + 1.0
    moved = rebuild(new_vertices)
    new_vertices[:] = 5.0
    assert np.array_equal(moved.vertices, VERTICES + 1.0)
    arrays.vertices[:] = 0.0
    moved.vertices[:] = -1.0
    moved.visual.vertex_colors[:] = 0
    moved.metadata["name"] = "other"
    assert np.array_equal(mesh.vertices, VERTICES)
    assert np.array_equal(mesh.faces, FACES)
    assert mesh.visual.vertex_colors[0].tolist() == [100, 101, 102, 103]
    assert mesh.metadata["name"] == "tetra"


def test_texture_and_colours_beside_it_are_kept() -> None:
    mesh = textured_mesh()
    arrays, rebuild = to_arrays(mesh)
    moved = rebuild(arrays.vertices + 1.0)
    assert np.array_equal(moved.visual.uv, mesh.visual.uv)
    assert moved.visual.vertex_attributes["color"].tolist() == [[9, 9, 9, 9]] * 5
    assert moved.visual.material.diffuse.tolist() == [200, 10, 20, 255]


def test_primitive_becomes_a_free_mesh() -> None:
    box = trimesh.primitives.Box()
    arrays, rebuild = to_arrays(box)
    assert np.array_equal(rebuild(arrays.vertices + 1.0).vertices, box.vertices + 1.0)


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.float16])
def test_numpy_pair_keeps_its_dtype(dtype: type) -> None:
    faces = FACES.astype(np.int16)
    arrays, rebuild = to_arrays((VERTICES.astype(dtype), faces))
    vertices, faces_out = rebuild(arrays.vertices + 0.5)
    assert vertices.dtype == dtype
    assert faces_out.dtype == np.int16
    assert faces_out is not faces
    assert np.array_equal(vertices, (VERTICES.astype(dtype).astype(float) + 0.5).astype(dtype))


def test_integer_vertices_come_back_as_floats() -> None:
    arrays, rebuild = to_arrays((np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]]), [[0, 1, 2]]))
    assert rebuild(arrays.vertices + 0.25)[0][0].tolist() == [0.25, 0.25, 0.25]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.bfloat16])
def test_torch_pair_stays_torch(dtype: torch.dtype) -> None:
    vertices = torch.tensor(VERTICES, dtype=dtype, requires_grad=True)
    faces = torch.tensor(FACES)
    arrays, rebuild = to_arrays((vertices, faces))
    new_vertices, new_faces = rebuild(arrays.vertices)
    assert new_vertices.dtype == dtype
    assert new_vertices.device == vertices.device
    assert torch.equal(new_vertices, vertices)
    assert torch.equal(new_faces, faces)
    assert new_faces.data_ptr() != faces.data_ptr()


def test_path_in_gives_a_trimesh_out(tmp_path: Path) -> None:
    save(colored_mesh(), tmp_path / "a.ply")
    for path in (tmp_path / "a.ply", str(tmp_path / "a.ply")):
        arrays, rebuild = to_arrays(path)
        assert isinstance(rebuild(arrays.vertices), trimesh.Trimesh)


def test_moved_vertices_must_have_the_same_shape() -> None:
    _, rebuild = to_arrays((VERTICES, FACES))
    with pytest.raises(MeshError, match=r"shape \(4, 3\), not \(5, 3\)"):
        rebuild(VERTICES[:4])


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (VERTICES, [[0, 1, 2], [0, 5, 2]], "face 1 refers to vertex 5, and the mesh has 5 vertices"),
        (VERTICES, [[0, 1, 2], [0, -1, 2]], "face 1 refers to vertex -1"),
        (VERTICES, np.zeros((0, 3), dtype=int), "no faces"),
        (VERTICES, [[0, 1, 2, 3]], "face 0 has 4 corners, not 3"),
        (VERTICES, [[0, 1, 2], [0, 1, 2, 3]], "face 1 has 4 corners, not 3"),
        (VERTICES, [[0.0, 1.0, 2.0]], "faces are of type float64"),
        (VERTICES, [0, 1, 2], r"faces have shape \(3,\)"),
        (VERTICES[:, :2], FACES, r"vertices have shape \(5, 2\)"),
        (np.full((3, 3), "a"), [[0, 1, 2]], "vertices are of type"),
        ([[0, 0, 0], [1, 0, np.nan], [0, 1, 0]], [[0, 1, 2]], r"vertex 1 is not finite: \(1.0, 0.0, nan\)"),
        ([[0, 0, 0], [1, 0, 0], [np.inf, 1, 0]], [[0, 1, 2]], "vertex 2 is not finite"),
    ],
)
def test_bad_pairs_are_named(vertices: object, faces: object, message: str) -> None:
    with pytest.raises(MeshError, match=message):
        to_arrays((vertices, faces))


@pytest.mark.parametrize(
    ("vertex_id", "hint"),
    [(1, "remove it, with the faces around it"), (3, "remove it, which no face uses")],
)
def test_a_vertex_that_is_not_finite_goes_alone_if_no_face_uses_it(vertex_id: int, hint: str) -> None:
    vertices = np.eye(4, 3)
    vertices[vertex_id, 2] = np.nan
    with pytest.raises(MeshError, match=f"vertex {vertex_id} is not finite") as caught:
        to_arrays((vertices, [[0, 1, 2]]))
    assert caught.value.hint == hint


@pytest.mark.parametrize("thing", [None, 3, {"vertices": []}, (VERTICES,), trimesh.Scene()])
def test_other_objects_are_refused_with_a_hint(thing: object) -> None:
    with pytest.raises(MeshError, match="cannot take a mesh from") as caught:
        to_arrays(thing)
    assert caught.value.hint is not None
    assert "vertices, faces" in caught.value.hint


# --- load: errors ------------------------------------------------------------------------------------


def test_missing_folder_and_unknown_files(tmp_path: Path) -> None:
    (tmp_path / "empty.ply").touch()
    (tmp_path / "folder.ply").mkdir()
    (tmp_path / "plain").mkdir()
    for name, message in [
        ("missing.ply", "no such file"),
        ("folder.ply", "is a folder"),
        ("plain", "is a folder"),
        ("empty.ply", "is empty"),
        ("a.fbx", "unknown mesh format '.fbx'"),
        ("noextension", "no file extension"),
    ]:
        with pytest.raises(MeshError, match=message):
            load(tmp_path / name)
    with pytest.raises(MeshError) as caught:
        load(tmp_path / "a.fbx")
    assert caught.value.hint == "supported: .ply, .obj, .stl, .off, .glb"


@pytest.mark.parametrize("extension", SUPPORTED)
def test_garbage_is_a_mesh_error_that_names_the_format(tmp_path: Path, extension: str) -> None:
    rng = np.random.default_rng(0)
    path = tmp_path / f"garbage{extension}"
    for data in (rng.bytes(1000), b"ply\n", b"OFF", b"solid x", b"glTF" + bytes(30), b"v 1 2 3\n", b"\xff"):
        path.write_bytes(data)
        with pytest.raises(MeshError, match=f"cannot read .* as {extension[1:].upper()}: ") as caught:
            load(path)
        assert caught.value.hint


@pytest.mark.parametrize("extension", SUPPORTED)
def test_every_truncation_is_noticed(tmp_path: Path, extension: str) -> None:
    whole = tmp_path / f"whole{extension}"
    cut = tmp_path / f"cut{extension}"
    save((VERTICES, FACES), whole)
    data = whole.read_bytes()
    # The last line of an OBJ or OFF file can lose its newline, or digits of its last number, unnoticed.
    n_optional = 2 if extension in (".obj", ".off") else 1
    for n_bytes in range(0, len(data) - n_optional, 7):
        cut.write_bytes(data[:n_bytes])
        if (
            extension == ".obj"
            and data[:n_bytes].count(b"\nf ") > 0
            and data[:n_bytes].endswith((b"\n", *(str(digit).encode() for digit in range(10))))
        ):
            continue  # an OBJ file announces no counts: cut between faces it is whole
        with pytest.raises(MeshError):
            load(cut)


def test_glb_is_cut_off_with_both_counts(tmp_path: Path) -> None:
    save((VERTICES, FACES), tmp_path / "a.glb")
    data = (tmp_path / "a.glb").read_bytes()
    (tmp_path / "a.glb").write_bytes(data[:-4])
    with pytest.raises(MeshError, match=f"announces {len(data)} bytes and holds {len(data) - 4}"):
        load(tmp_path / "a.glb")


# --- save --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("extension", SUPPORTED)
@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_round_trip_keeps_order_and_precision(tmp_path: Path, extension: str, offset: float) -> None:
    path = tmp_path / f"mesh{extension}"
    vertices = VERTICES + offset
    save((vertices, FACES), path)
    mesh = load(path)
    if extension == ".stl":
        assert np.array_equal(mesh.faces, np.arange(12).reshape(4, 3))
    else:
        assert np.array_equal(mesh.faces, FACES)
        assert len(mesh.vertices) == len(vertices)
    assert np.abs(mesh.vertices[mesh.faces] - vertices[FACES]).max() < 1e-6
    save(mesh, path)
    assert np.array_equal(load(path).vertices, mesh.vertices)


@pytest.mark.parametrize("extension", SUPPORTED)
def test_save_leaves_the_mesh_alone(tmp_path: Path, extension: str) -> None:
    for mesh in (colored_mesh(), textured_mesh()):
        keys = set(mesh.vertex_attributes)
        save(mesh, tmp_path / f"mesh{extension}")
        assert set(mesh.vertex_attributes) == keys
        assert np.array_equal(mesh.vertices, VERTICES)


@pytest.mark.parametrize("extension", [".ply", ".obj", ".glb"])
def test_cached_normals_are_not_written(tmp_path: Path, extension: str) -> None:
    mesh = colored_mesh()
    assert mesh.vertex_normals.shape == (5, 3)
    path = tmp_path / f"mesh{extension}"
    save(mesh, path)
    data = path.read_bytes()
    assert b"nx" not in data
    assert b"\nvn " not in data
    assert b"NORMAL" not in data


def test_unknown_extension_is_refused_before_any_work(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match=r"unknown mesh format '\.step'") as caught:
        save("not even a mesh", tmp_path / "a.step")
    assert caught.value.hint == "supported: .ply, .obj, .stl, .off, .glb"


def test_failed_write_keeps_the_old_file_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.ply"
    path.write_bytes(b"old")

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(MeshError, match="No space left on device"):
        save((VERTICES, FACES), path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.ply"]
    assert path.read_bytes() == b"old"


def test_written_file_has_ordinary_permissions(tmp_path: Path) -> None:
    mask = os.umask(0o022)
    try:
        save((VERTICES, FACES), tmp_path / "a.ply")
    finally:
        os.umask(mask)
    assert stat.S_IMODE((tmp_path / "a.ply").stat().st_mode) == 0o644
    (tmp_path / "a.ply").chmod(0o600)
    save((VERTICES, FACES), tmp_path / "a.ply")
    assert stat.S_IMODE((tmp_path / "a.ply").stat().st_mode) == 0o600


def test_link_is_followed_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "real.ply").write_bytes(b"old")
    (tmp_path / "link.ply").symlink_to(tmp_path / "real.ply")
    save((VERTICES, FACES), tmp_path / "link.ply")
    assert (tmp_path / "link.ply").is_symlink()
    assert np.array_equal(load(tmp_path / "real.ply").faces, FACES)


def test_attribute_that_ply_cannot_hold_is_named(tmp_path: Path) -> None:
    mesh = colored_mesh()
    mesh.vertex_attributes["my name"] = np.zeros(5)
    with pytest.raises(MeshError, match="vertex attribute 'my name'"):
        save(mesh, tmp_path / "a.ply")
    mesh = colored_mesh()
    mesh.face_attributes["id"] = np.array([0, 1, 2, 2**40])
    with pytest.raises(MeshError, match="beyond 32 bits"):
        save(mesh, tmp_path / "a.ply")
    assert not (tmp_path / "a.ply").exists()


# --- check_output_path -------------------------------------------------------------------------------


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names here")
def test_a_pipe_is_no_place_for_a_result(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.ply"
    os.mkfifo(pipe)
    with pytest.raises(MeshError, match=r"pipe\.ply is a device or a pipe, which a file would replace"):
        check_output_path(pipe, tmp_path / "a.ply")
    with pytest.raises(OSError, match="which no file replaces"):
        write_atomic(pipe, b"x")
    assert pipe.is_fifo()
    assert [path.name for path in tmp_path.iterdir()] == ["pipe.ply"]


def test_output_must_not_be_the_input(tmp_path: Path) -> None:
    save((VERTICES, FACES), tmp_path / "a.ply")
    (tmp_path / "link.ply").symlink_to(tmp_path / "a.ply")
    os.link(tmp_path / "a.ply", tmp_path / "hard.ply")
    for name in ("a.ply", "link.ply", "hard.ply"):
        with pytest.raises(MeshError, match="is the input itself"):
            check_output_path(tmp_path / name, tmp_path / "a.ply")
    check_output_path(tmp_path / "b.ply", tmp_path / "a.ply")
    check_output_path(tmp_path / "a.ply", tmp_path / "does-not-exist.ply")
    with pytest.raises(MeshError, match="another file of this run"):
        check_output_path(tmp_path / "b.ply", tmp_path / "a.ply", tmp_path / "x" / ".." / "b.ply")
    check_output_path(tmp_path / "a.json", tmp_path / "a.ply", is_mesh=False)
    with pytest.raises(GcndError, match="is a folder") as caught:
        check_output_path(tmp_path, is_mesh=False)
    assert not isinstance(caught.value, MeshError)


def test_output_folder_must_exist(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match="does not exist"):
        check_output_path(tmp_path / "no" / "a.ply")
    (tmp_path / "folder.ply").mkdir()
    for folder in (tmp_path / "folder.ply", tmp_path):
        with pytest.raises(MeshError, match="is a folder"):
            check_output_path(folder)


def test_protected_output_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # By a stand-in for os.access: the tests may run as root, whom no permission stops.
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(MeshError, match="permission denied"):
        check_output_path(tmp_path / "a.ply")


def test_errors_are_what_callers_may_catch() -> None:
    assert issubclass(MeshError, GcndError)
    assert issubclass(MeshError, ValueError)

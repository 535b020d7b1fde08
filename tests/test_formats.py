"""Each mesh format: what is read, what is kept, and how a fault in the file is named."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from gcnd.errors import MeshError, MeshWarning
from gcnd.filters import Filter
from gcnd.formats.export import needs_float64
from gcnd.formats.parsed import ParsedMesh, rgba_from_values, split_seams
from gcnd.formats.ply import read_ply, write_ply
from gcnd.many import denoise_many
from gcnd.mesh_io import load, read_shape, save

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
TWO_FACES = np.array([[0, 1, 2], [0, 2, 3]])


def written(tmp_path: Path, name: str, content: str | bytes) -> Path:
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


# --- shared steps ------------------------------------------------------------------------------------


@settings(max_examples=200, deadline=None)
@given(st.integers(3, 12), st.integers(1, 15), st.integers(0, 6), st.integers(0, 2**32 - 1))
def test_split_seams_keeps_every_corner(n_vertices: int, n_faces: int, n_values: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    faces = rng.integers(0, n_vertices, (n_faces, 3))
    corner_values = rng.integers(-1, n_values, (n_faces, 3)) if n_values else np.full((n_faces, 3), -1)
    new_faces, source, value = split_seams(faces, corner_values, n_vertices)
    assert np.array_equal(source[:n_vertices], np.arange(n_vertices))
    assert np.array_equal(source[new_faces], faces)
    has_value = corner_values >= 0
    assert np.array_equal(value[new_faces][has_value], corner_values[has_value])
    pairs = {(v, t) for v, t in zip(faces.ravel(), corner_values.ravel(), strict=True) if t >= 0}
    vertices_with_value = {v for v, _ in pairs}
    assert len(source) == n_vertices + len(pairs) - len(vertices_with_value)


def test_copies_follow_in_the_order_of_the_file() -> None:
    faces = np.array([[0, 1, 2], [2, 1, 0]])
    new_faces, source, value = split_seams(faces, np.array([[0, 1, 2], [5, 4, 3]]), 3)
    assert new_faces.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert source.tolist() == [0, 1, 2, 2, 1, 0]
    assert value.tolist() == [0, 1, 2, 5, 4, 3]


def test_colours_of_every_type() -> None:
    assert rgba_from_values(np.array([[0.0, 0.5, 1.0, 0.2]])).tolist() == [[0, 128, 255, 51]]
    assert rgba_from_values(np.array([[1, 0, 255]], dtype=np.uint8)).tolist() == [[1, 0, 255, 255]]
    assert rgba_from_values(np.array([[65535, 257, 0]], dtype=np.uint16)).tolist() == [[255, 1, 0, 255]]
    assert rgba_from_values(np.array([[255.0, 1.0, 0.0]])).tolist() == [[255, 1, 0, 255]]


def test_needs_float64_by_its_definition() -> None:
    # 2^20 is far from the origin: neighbouring 32-bit numbers are 1/8 apart, so 1/16 is lost.
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    faces = np.array([[0, 1, 2]])
    assert not needs_float64(corners + 2.0**20, faces)
    assert needs_float64(corners + 2.0**20 + 1 / 16, faces)
    assert not needs_float64(corners * 1000 + 2.0**20 + 1 / 16, faces)
    assert not needs_float64(np.zeros((0, 3)), np.zeros((0, 3), dtype=int))


# --- PLY ---------------------------------------------------------------------------------------------

TEXT_PLY = """ply
format ascii 1.0
comment made by hand
element vertex 4
property float x
property float y
property float z
property float nx
property float ny
property float nz
property uchar red
property uchar green
property uchar blue
property float quality
element face 2
property list uchar int vertex_indices
property int label
element edge 1
property int vertex1
property int vertex2
end_header
0 0 0 0 0 1 10 20 30 0.5
1000000.3 0 0 0 0 1 11 21 31 1.5
1 1 0 0 0 1 12 22 32 2.5
0 1 0 0 0 1 13 23 33 3.5
3 0 1 2 7
3 0 2 3 -9
0 1
"""


def test_text_ply(tmp_path: Path) -> None:
    mesh = load(written(tmp_path, "a.ply", TEXT_PLY))
    assert mesh.vertices[1].tolist() == [1000000.3, 0, 0]
    assert mesh.faces.tolist() == TWO_FACES.tolist()
    assert mesh.visual.vertex_colors[3].tolist() == [13, 23, 33, 255]
    assert mesh.vertex_attributes["quality"].tolist() == [0.5, 1.5, 2.5, 3.5]
    assert mesh.face_attributes["label"].tolist() == [7, -9]
    assert set(mesh.vertex_attributes) == {"quality"}


def test_ply_values_survive_a_second_trip(tmp_path: Path) -> None:
    first = load(written(tmp_path, "a.ply", TEXT_PLY))
    first.vertex_attributes["pair"] = np.arange(8, dtype=np.float64).reshape(4, 2)
    save(first, tmp_path / "b.ply")
    second = load(tmp_path / "b.ply")
    assert np.array_equal(first.visual.vertex_colors, second.visual.vertex_colors)
    for name in ("quality", "pair"):
        assert np.array_equal(first.vertex_attributes[name], second.vertex_attributes[name])
        assert first.vertex_attributes[name].dtype == second.vertex_attributes[name].dtype
    assert second.face_attributes["label"].tolist() == [7, -9]


def test_written_ply_is_read_alike_by_trimesh(tmp_path: Path) -> None:
    mesh = trimesh.Trimesh(SQUARE, TWO_FACES, process=False)
    mesh.visual.face_colors = [[1, 2, 3, 4], [5, 6, 7, 8]]
    save(mesh, tmp_path / "a.ply")
    other = trimesh.load_mesh(tmp_path / "a.ply", process=False)
    assert np.array_equal(other.vertices, SQUARE)
    assert np.array_equal(other.faces, TWO_FACES)
    assert np.array_equal(other.visual.face_colors, mesh.visual.face_colors)


def test_both_kinds_of_colour_survive(tmp_path: Path) -> None:
    colors = np.arange(16, dtype=np.uint8).reshape(4, 4)
    parsed = ParsedMesh(SQUARE, TWO_FACES, vertex_colors=colors, face_colors=colors[:2] + 100)
    mesh = load(written(tmp_path, "a.ply", write_ply(parsed, float64=False)))
    assert np.array_equal(mesh.visual.vertex_colors, colors)
    assert mesh.face_attributes["red"].tolist() == [100, 104]
    save(mesh, tmp_path / "b.ply")
    assert (tmp_path / "b.ply").read_bytes() == (tmp_path / "a.ply").read_bytes()


@pytest.mark.parametrize("is_double", [False, True])
def test_ply_keeps_64_bits_where_the_input_had_them(tmp_path: Path, is_double: bool) -> None:
    path = written(tmp_path, "a.ply", write_ply(ParsedMesh(SQUARE, TWO_FACES), float64=is_double))
    save(load(path), tmp_path / "b.ply")
    assert (b"property double x" in (tmp_path / "b.ply").read_bytes()) is is_double


def test_big_endian_ply_whose_data_begins_like_a_line_ending() -> None:
    header = (
        b"ply\r\nformat binary_big_endian 1.0\r\nelement vertex 3\r\n"
        b"property double x\r\nproperty double y\r\nproperty double z\r\n"
        b"element face 1\r\nproperty list uint8 int32 vertex_index\r\nend_header\r\n"
    )
    first = struct.unpack(">d", b"\n\x0d" + bytes(6))[0]
    corners = np.array([[first, 2, 3], [4, 5, 6], [7, 8, 9.5]], dtype=">f8")
    parsed = read_ply(header + corners.tobytes() + struct.pack(">Biii", 3, 0, 1, 2))
    assert np.array_equal(parsed.vertices, corners)
    assert parsed.vertices.dtype == np.dtype("=f8")
    assert parsed.faces.tolist() == [[0, 1, 2]]


def binary_ply(faces: list[list[int]]) -> bytes:
    header = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = b"".join(struct.pack(f"<B{len(face)}i", len(face), *face) for face in faces)
    return header.encode() + SQUARE.astype("<f4").tobytes() + rows


@pytest.mark.parametrize(
    ("faces", "message"),
    [
        ([[0, 1, 2, 3]], "face 0 has 4 corners, not 3"),
        ([[0, 1, 2], [0, 2, 3], [0, 1, 2, 3], [0, 1, 2]], "face 2 has 4 corners, not 3"),
        ([[0, 1, 2], [0, 1, 2, 3, 0, 1]], "face 1 has 6 corners, not 3"),
        ([[0, 1, 2], [0, 1], [0, 1, 2]], "face 1 has 2 corners, not 3"),
    ],
)
def test_polygons_in_ply_are_named(tmp_path: Path, faces: list[list[int]], message: str) -> None:
    with pytest.raises(MeshError, match=message) as caught:
        load(written(tmp_path, "a.ply", binary_ply(faces)))
    assert ("triangulate" in (caught.value.hint or "")) is ("2 corners" not in message)
    text = TEXT_PLY[: TEXT_PLY.index("3 0 1 2 7")].replace("element face 2", f"element face {len(faces)}")
    text += "".join(f"{len(face)} {' '.join(map(str, face))} 0\n" for face in faces) + "0 1\n"
    with pytest.raises(MeshError, match=message):
        load(written(tmp_path, "b.ply", text))


def test_ply_texture_coordinates_per_face_split_the_seam_only(tmp_path: Path) -> None:
    header = (
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 2\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\n"
        "end_header\n"
    )
    corners = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"
    faces = "3 0 1 2 6 0 0 1 0 1 1\n3 0 2 3 6 0.5 0.5 1 1 0 1\n"
    mesh = load(written(tmp_path, "a.ply", header + corners + faces))
    assert mesh.faces.tolist() == [[0, 1, 2], [4, 2, 3]]
    assert np.array_equal(mesh.vertices, SQUARE[[0, 1, 2, 3, 0]])
    assert mesh.visual.uv.tolist() == [[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5]]
    save(mesh, tmp_path / "b.ply")
    again = load(tmp_path / "b.ply")
    assert np.array_equal(again.visual.uv, mesh.visual.uv)
    assert np.array_equal(again.faces, mesh.faces)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("element vertex 4", "element vertex -4", "header line 'element vertex -4' makes no sense"),
        ("element vertex 4", "element vertex four", "makes no sense"),
        ("property float x", "property long x", "makes no sense"),
        ("property float x", "property float w", "no vertices with x, y and z"),
        ("property float y", "property float x", "its element 'vertex' has two properties 'x'"),
        ("property float y", "property list uchar int x", "its element 'vertex' has two properties 'x'"),
        ("format ascii 1.0\n", "", "no format line"),
        ("end_header", "endheader", "no end_header"),
        ("1 1 0 0 0 1", "1 1 zero 0 0 1", "not a number"),
        ("0 1\n", "0 1\n3 3\n", "2 numbers follow"),
        ("element face 2", "element face 3", "announces"),
        ("1 1 0 0 0 1", "nan 1 0 0 0 1", "vertex 2 is not finite"),
        ("3 0 2 3 -9", "3 0 2 4 -9", "face 1 refers to vertex 4"),
    ],
)
def test_faults_of_a_ply_file_are_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    head, _, tail = TEXT_PLY.rpartition(old) if old == "0 1\n" else TEXT_PLY.partition(old)
    with pytest.raises(MeshError, match=message):
        load(written(tmp_path, "a.ply", head + new + tail))


def test_point_cloud_is_refused(tmp_path: Path) -> None:
    cloud = TEXT_PLY[: TEXT_PLY.index("element face")] + "end_header\n"
    cloud += TEXT_PLY.partition("end_header\n")[2].partition("3 0 1 2")[0]
    for name, content in [
        ("a.ply", cloud),
        ("a.obj", "v 0 0 0\nv 1 0 0\n"),
        ("a.off", "OFF\n1 0 0\n0 0 0\n"),
    ]:
        with pytest.raises(MeshError, match="no faces") as caught:
            load(written(tmp_path, name, content))
        assert caught.value.hint == "a point cloud must be meshed first"


def test_a_file_of_nothing_is_empty_and_no_point_cloud(tmp_path: Path) -> None:
    ply = "ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\nproperty float z\n"
    ply += "element face 0\nproperty list uchar int vertex_indices\nend_header\n"
    for name, content in [
        ("a.ply", ply),
        ("a.off", "OFF\n0 0 0\n"),
        ("a.stl", bytes(84)),
    ]:
        with pytest.raises(MeshError, match="the mesh is empty: it has no vertices and no faces") as caught:
            load(written(tmp_path, name, content))
        assert caught.value.hint == "look at what made it"


# --- OFF and STL -------------------------------------------------------------------------------------


def test_off_variants(tmp_path: Path) -> None:
    plain = "OFF # a comment\n\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 3\n"
    same_line = plain.replace("OFF # a comment\n\n4", "OFF 4")
    for content in (plain, same_line):
        mesh = load(written(tmp_path, "a.off", content))
        assert np.array_equal(mesh.vertices, SQUARE)
        assert np.array_equal(mesh.faces, TWO_FACES)
    rows = "0 0 0 0 0 1 255 0 1 9\n1 0 0 0 0 1 2 3 4 9\n1 1 0 0 0 1 5 6 7 9\n0 1 0 0 0 1 8 9 10 9\n"
    mesh = load(written(tmp_path, "b.off", f"CNOFF\n4 1 0\n{rows}3 0 1 2\n"))
    assert mesh.visual.vertex_colors[:2].tolist() == [[255, 0, 1, 9], [2, 3, 4, 9]]
    mesh = load(written(tmp_path, "c.off", plain.replace("3 0 1 2\n", "3 0 1 2 1.0 0 0\n") + "0"))
    assert mesh.visual.kind is None


def test_off_colours_survive(tmp_path: Path) -> None:
    mesh = trimesh.Trimesh(SQUARE, TWO_FACES, process=False)
    mesh.visual.face_colors = [[1, 2, 3, 4], [5, 6, 7, 8]]
    save(mesh, tmp_path / "a.off")
    assert np.array_equal(load(tmp_path / "a.off").visual.face_colors, mesh.visual.face_colors)
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=np.arange(16, dtype=np.uint8).reshape(4, 4))
    save(mesh, tmp_path / "a.off")
    assert np.array_equal(load(tmp_path / "a.off").visual.vertex_colors, mesh.visual.vertex_colors)


def test_faults_of_an_off_file_are_named(tmp_path: Path) -> None:
    rows = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"
    for content, message in [
        (f"OFF\n4 2 0\n{rows}3 0 1 2\n4 0 1 2 3\n", "face 1 has 4 corners, not 3"),
        (f"OFF\n4 2 0\n{rows}3 0 1 2\n", "announces 2 faces and holds 1"),
        (f"OFF\n5 0 0\n{rows}", "announces 5 vertices and holds 4"),
        ("OFF BINARY\n", "binary OFF"),
        ("OFF\nfour 2 0\n", "counts is missing"),
        (f"OFF\n4 1 0\n{rows}3 0 1 x\n", "no index"),
        ("OFF\n3 1 0\n0 0 0\n1 0\n0 1 0\n3 0 1 2\n", "vertex 1 has 2 coordinates"),
    ]:
        with pytest.raises(MeshError, match=message):
            load(written(tmp_path, "a.off", content))


def stl_text(faces: list[list[tuple[float, float, float]]]) -> str:
    loops = ""
    for face in faces:
        corners = "".join(f"  VERTEX {x} {y} {z}\n" for x, y, z in face)
        loops += f"facet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet\n"
    return f"solid thing\n{loops}endsolid thing\n"


def test_text_stl_of_two_solids(tmp_path: Path) -> None:
    one = stl_text([[(0, 0, 0), (1e-3, 0, 0), (0, 1, 0)]])
    two = stl_text([[(5, 0, 0), (6, 0, 0), (5, 1, 0)]])
    mesh = load(written(tmp_path, "a.stl", one + two))
    assert mesh.vertices.tolist() == [[0, 0, 0], [1e-3, 0, 0], [0, 1, 0], [5, 0, 0], [6, 0, 0], [5, 1, 0]]
    assert mesh.faces.tolist() == [[0, 1, 2], [3, 4, 5]]
    quad = stl_text([[(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]])
    with pytest.raises(MeshError, match="face 1 has 4 corners, not 3"):
        load(written(tmp_path, "b.stl", quad))
    with pytest.raises(MeshError, match="does not end with endsolid"):
        load(written(tmp_path, "c.stl", (one + two).replace("endsolid thing\nsolid", "solid")[:-16]))


def test_binary_stl_that_begins_with_solid(tmp_path: Path) -> None:
    save((SQUARE, TWO_FACES), tmp_path / "a.stl")
    data = bytearray((tmp_path / "a.stl").read_bytes())
    data[:5] = b"solid"
    data[84 + 48 : 84 + 50] = struct.pack("<H", 77)
    mesh = load(written(tmp_path, "b.stl", bytes(data)))
    assert np.array_equal(mesh.vertices, SQUARE[TWO_FACES].reshape(-1, 3))
    assert mesh.face_attributes["stl"].tolist() == [77, 0]
    save(mesh, tmp_path / "c.stl")
    assert load(tmp_path / "c.stl").face_attributes["stl"].tolist() == [77, 0]
    with pytest.raises(MeshError, match="announces 100 bytes of faces and holds 90"):
        load(written(tmp_path, "d.stl", bytes(data[:-10])))
    with pytest.raises(MeshError, match="50 bytes follow the 2 faces"):
        load(written(tmp_path, "e.stl", bytes(data) + bytes(50)))


@pytest.mark.parametrize("n_more", [1, 49])
def test_a_few_bytes_behind_a_binary_stl_are_told_and_kept(tmp_path: Path, n_more: int) -> None:
    save((SQUARE, TWO_FACES), tmp_path / "a.stl")
    data = (tmp_path / "a.stl").read_bytes()
    source = written(tmp_path, "b.stl", data + bytes(range(1, n_more + 1)))
    message = f"{source}: {n_more} bytes behind its 2 faces belong to none"
    for read in (load, read_shape):
        with pytest.warns(MeshWarning, match=re.escape(message)) as told:
            read(source)
        assert [warning.filename for warning in told] == [__file__]
    with pytest.warns(MeshWarning):
        (outcome,) = denoise_many([source], tmp_path / "out", denoiser=Filter("taubin"), reports=True)
    assert outcome.warnings[0] == message
    assert outcome.report is not None
    assert outcome.report["warnings"] == list(outcome.warnings)
    result = (tmp_path / "out" / "b.stl").read_bytes()
    assert result[len(data) :] == bytes(range(1, n_more + 1))
    assert result[:84] == data[:84]
    plain = written(tmp_path, "c.stl", data)
    denoise_many([plain], tmp_path / "out", denoiser=Filter("taubin"))
    assert result[: len(data)] == (tmp_path / "out" / "c.stl").read_bytes()


def test_triangle_strips_are_no_point_cloud(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "element tristrips 1\nproperty list int int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    )
    with pytest.raises(MeshError, match="triangle strips and no faces") as caught:
        load(path)
    assert "MeshLab" in str(caught.value.hint)


@pytest.mark.parametrize("extension", [".xyz", ".pcd", ".las"])
def test_formats_of_point_clouds_say_how_to_proceed(tmp_path: Path, extension: str) -> None:
    (tmp_path / f"a{extension}").write_text("0 0 0\n")
    with pytest.raises(MeshError, match="unknown mesh format") as caught:
        load(tmp_path / f"a{extension}")
    assert "a point cloud must be meshed first" in str(caught.value.hint)

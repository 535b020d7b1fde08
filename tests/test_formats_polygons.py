"""Faces of more than three corners: refused with advice, or split for the work and written whole again."""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gcnd.cli import main
from gcnd.errors import MeshError
from gcnd.filters import Filter, apply_filter
from gcnd.formats.polygons import split_polygons
from gcnd.many import denoise_many
from gcnd.mesh_io import load, save, to_arrays

SIDE = 6
RNG = np.random.default_rng(0)


def mixed_mesh() -> tuple[np.ndarray, list[list[int]]]:
    """A bumpy grid of quads with a triangle pair and a pentagon among them; float32 positions."""
    x, y = np.meshgrid(np.arange(SIDE + 1.0), np.arange(SIDE + 1.0))
    vertices = np.stack([x.ravel(), y.ravel(), 0.2 * RNG.normal(size=x.size)], axis=1).astype(np.float32)
    first = [row * (SIDE + 1) + column for row in range(SIDE) for column in range(SIDE)]
    faces = [[a, a + 1, a + SIDE + 2, a + SIDE + 1] for a in first]
    a, b, c, d = faces[7]
    faces[7:8] = [[a, b, c], [a, c, d]]
    # The pentagon takes a corner of its right neighbour, which becomes a triangle.
    left, right = faces[20], faces[21]
    assert (left[1], left[2]) == (right[0], right[3])
    faces[20] = [left[0], left[1], right[2], left[2], left[3]]
    faces[21] = [right[0], right[1], right[2]]
    return vertices.astype(np.float64), faces


VERTICES, FACES = mixed_mesh()
TRIANGLES = to_arrays((VERTICES, FACES), triangulate=True)[0].faces
EXPECTED = apply_filter((VERTICES, TRIANGLES), "taubin")[0]
NORMALS = RNG.normal(size=VERTICES.shape)
COLORS = RNG.integers(0, 255, (len(FACES), 3))


def text(row: Any) -> str:
    return " ".join(str(float(x)) for x in row)


def obj_file() -> bytes:
    lines = ["# quads", "o grid", *(f"v {text(v)}" for v in VERTICES), *(f"vn {text(n)}" for n in NORMALS)]
    lines += [f"vt {k / 100} 0.5" for k in range(len(VERTICES))]
    for number, face in enumerate(FACES):
        if number == 10:
            lines.append("g half  # of it")
        last = -len(VERTICES)
        words = [
            f"{v + last}/{v + 1}/{v + 1}" if number % 5 == 0 else f"{v + 1}/{v + 1}/{v + 1}" for v in face
        ]
        lines.append("f " + "  ".join(words) + (" # odd" if len(face) != 4 else ""))
    return ("\r\n".join(lines) + "\r\n").encode()


def off_file() -> bytes:
    lines = ["OFF # quads", f"{len(VERTICES)} {len(FACES)} 0", *map(text, VERTICES)]
    for face, color in zip(FACES, COLORS, strict=True):
        lines.append(" ".join(map(str, [len(face), *face, *color])))
    return ("\n".join(lines) + "\n").encode()


PLY_HEADER = f"""ply
format {{}} 1.0
comment quads
element vertex {len(VERTICES)}
property float x
property float y
property float z
property float nx
property float ny
property float nz
element face {len(FACES)}
property uchar red
property uchar green
property uchar blue
property list uchar int vertex_indices
property float nx
property float ny
property float nz
element extra 2
property int value
end_header
"""


def ply_file(kind: str) -> bytes:
    rows = list(zip(COLORS.tolist(), FACES, strict=True))
    if kind == "ascii":
        body = [f"{text(v)} {text(n.astype(np.float32))}" for v, n in zip(VERTICES, NORMALS, strict=True)]
        body += [" ".join(map(str, [*color, len(face), *face, 0, 0, 1])) for color, face in rows]
        return (PLY_HEADER.format("ascii") + "\n".join([*body, "7", "8"]) + "\n").encode()
    order = "<" if kind == "little" else ">"
    data = [struct.pack(f"{order}6f", *v, *n) for v, n in zip(VERTICES, NORMALS, strict=True)]
    for color, face in rows:
        data.append(struct.pack(f"{order}3BB{len(face)}i3f", *color, len(face), *face, 0, 0, 1))
    data.append(struct.pack(f"{order}2i", 7, 8))
    return PLY_HEADER.format(f"binary_{kind}_endian").encode() + b"".join(data)


FILES = {
    "in.obj": obj_file(),
    "in.off": off_file(),
    "ascii.ply": ply_file("ascii"),
    "little.ply": ply_file("little"),
    "big.ply": ply_file("big"),
}


def polygon_normals(vertices: np.ndarray) -> np.ndarray:
    """Of every face, by an independent sum over its edges."""
    sums = [
        sum(np.cross(vertices[a], vertices[b]) for a, b in zip(f, f[1:] + f[:1], strict=True)) for f in FACES
    ]
    return np.array([s / np.linalg.norm(s) for s in sums])


# --- splitting ---------------------------------------------------------------------------------------


def split(points: list[list[float]]) -> list[list[int]]:
    vertices = np.array([[*p, 0.0] if len(p) == 2 else p for p in points], dtype=np.float64)
    return split_polygons(vertices, np.arange(len(points)), np.array([len(points)])).corners.tolist()


def test_a_quad_is_split_along_its_shorter_diagonal() -> None:
    assert split([[0, 0], [2, 0], [3, 1], [0, 1]]) == [[0, 1, 3], [1, 2, 3]]
    assert split([[0, 0], [3, 0], [2, 1], [0, 1]]) == [[0, 1, 2], [0, 2, 3]]
    assert split([[0, 0], [1, 0], [1, 1], [0, 1]]) == [[0, 1, 2], [0, 2, 3]]


def test_a_dart_is_split_at_its_dent_though_the_diagonal_is_longer() -> None:
    dart = [[0.0, 0.0], [4.0, 3.0], [0.0, 1.0], [-4.0, 3.0]]
    assert split(dart) == [[0, 1, 2], [0, 2, 3]]
    assert split(dart[1:] + dart[:1]) == [[0, 1, 3], [1, 2, 3]]
    wide = [[0.0, 0.0], [1.0, 9.0], [0.0, 8.0], [-1.0, 9.0]]
    assert split(wide) == [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize("turn", [np.eye(3), np.diag([1.0, -1.0, -1.0]), np.roll(np.eye(3), 1, axis=0)])
def test_larger_polygons_keep_their_area_and_direction(turn: np.ndarray) -> None:
    """A comb of 12 corners: no triangle lies outside, none is turned, and together they are all of it."""
    comb = [(0, 0), (5, 0), (5, 3), (4, 3), (4, 1), (3, 1), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)]
    points = np.array([[*p, 0.0] for p in comb]) @ turn.T
    found = split_polygons(points, np.arange(12), np.array([12]))
    assert found.corners.shape == (10, 3)
    a, b, c = (points[found.corners[:, k]] for k in range(3))
    areas = np.cross(b - a, c - a) @ (turn @ [0.0, 0.0, 1.0]) / 2.0
    assert (areas > 0.0).all()
    assert areas.sum() == pytest.approx(11.0)


def test_faces_stay_in_order_and_crossed_ones_do_no_harm() -> None:
    star = np.array([[np.sin(k * 0.8 * np.pi), np.cos(k * 0.8 * np.pi), 0.0] for k in range(5)])
    found = split_polygons(star, np.array([0, 1, 2, 0, 1, 2, 3, 4, 1, 2, 3]), np.array([3, 5, 3]))
    assert found.owner.tolist() == [0, 1, 1, 1, 2]
    assert found.corners[[0, 4]].tolist() == [[0, 1, 2], [8, 9, 10]]
    assert sorted(set(found.corners[1:4].ravel().tolist())) == [3, 4, 5, 6, 7]


# --- files -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FILES)
def test_without_the_switch_the_error_names_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    (tmp_path / name).write_bytes(FILES[name])
    assert main(["denoise", str(tmp_path / name), str(tmp_path / f"out-{name}"), "--method", "taubin"]) == 1
    told = capsys.readouterr().err
    assert "face 0" in told
    assert "has 4 corners, not 3" in told
    assert "hint: gcnd denoise --triangulate" in told


@pytest.mark.parametrize("name", FILES)
def test_polygons_come_out_whole_with_their_vertices_moved(tmp_path: Path, name: str) -> None:
    source, out = tmp_path / name, tmp_path / "out" / name
    out.parent.mkdir()
    source.write_bytes(FILES[name])
    program = ["denoise", str(source), str(out), "--method", "taubin", "--quiet", "--triangulate"]
    assert main([*program, "--strength", "0"]) == 0
    assert out.read_bytes() == FILES[name]
    assert main(program) == 0
    mesh = load(out, triangulate=True)
    assert mesh.metadata["polygons"] == len(FACES)
    assert np.allclose(mesh.vertices, EXPECTED, atol=1e-6)
    if name.endswith("ply"):
        return
    before, after = FILES[name].decode().splitlines(), out.read_bytes().decode().splitlines()
    starts = ("v ", "vn") if name == "in.obj" else tuple("-0123456789")
    faces = range(2 + len(VERTICES), len(before)) if name == "in.off" else range(len(before))
    kept = [k for k in faces if name == "in.off" or not before[k].startswith(starts)]
    assert len(kept) >= len(FACES)
    assert [before[k] for k in kept] == [after[k] for k in kept]


@pytest.mark.parametrize("kind", ["ascii", "little", "big"])
def test_ply_keeps_all_but_positions_and_normals(tmp_path: Path, kind: str) -> None:
    name = f"{kind}.ply"
    (tmp_path / name).write_bytes(FILES[name])
    save(
        apply_filter(load(tmp_path / name, triangulate=True), "taubin"),
        tmp_path / "out.ply",
        like=tmp_path / name,
    )
    found = (tmp_path / "out.ply").read_bytes()
    assert found.startswith(
        PLY_HEADER.format("ascii" if kind == "ascii" else f"binary_{kind}_endian").encode()
    )
    wanted = polygon_normals(EXPECTED)
    body = found[found.index(b"end_header\n") + 11 :]
    if kind == "ascii":
        rows = [line.split() for line in body.decode().splitlines()]
        assert rows[-2:] == [["7"], ["8"]]
        faces = rows[len(VERTICES) : -2]
        assert [[int(w) for w in row[:-3]] for row in faces] == [
            [*color, len(face), *face] for color, face in zip(COLORS.tolist(), FACES, strict=True)
        ]
        normals = np.array([row[-3:] for row in faces], dtype=np.float64)
    else:
        order, place = "<" if kind == "little" else ">", 24 * len(VERTICES)
        normals = np.zeros((len(FACES), 3))
        for number, (color, face) in enumerate(zip(COLORS.tolist(), FACES, strict=True)):
            layout = f"{order}3BB{len(face)}i3f"
            row = struct.unpack_from(layout, body, place)
            assert row[:-3] == (*color, len(face), *face)
            normals[number] = row[-3:]
            place += struct.calcsize(layout)
        assert struct.unpack_from(f"{order}2i", body, place) == (7, 8)
        assert len(body) == place + 8
    assert np.allclose(normals, wanted, atol=1e-5)


def test_normals_of_an_obj_are_those_of_its_polygons(tmp_path: Path) -> None:
    (tmp_path / "in.obj").write_bytes(FILES["in.obj"])
    mesh = load(tmp_path / "in.obj", triangulate=True)
    moved = VERTICES + 0.1 * np.random.default_rng(1).normal(size=VERTICES.shape)
    mesh.vertices = moved
    save(mesh, tmp_path / "out.obj", like=tmp_path / "in.obj")
    lines = (tmp_path / "out.obj").read_text().splitlines()
    normals = np.array([line.split()[1:] for line in lines if line.startswith("vn")], dtype=np.float64)
    sums = np.zeros_like(VERTICES)
    for a, b, c in TRIANGLES:
        sums[[a, b, c]] += np.cross(moved[b] - moved[a], moved[c] - moved[a])
    assert np.allclose(normals, sums / np.linalg.norm(sums, axis=1, keepdims=True), atol=1e-6)


def test_what_belongs_to_a_face_goes_to_its_triangles(tmp_path: Path) -> None:
    for name in ("little.ply", "in.off"):
        (tmp_path / name).write_bytes(FILES[name])
        mesh = load(tmp_path / name, triangulate=True)
        owner = [k for k, face in enumerate(FACES) for _ in face[2:]]
        assert np.array_equal(mesh.visual.face_colors[:, :3], COLORS[owner]), name


def test_another_format_or_a_confidence_is_refused_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "in.obj").write_bytes(FILES["in.obj"])
    program = ["denoise", str(tmp_path / "in.obj"), str(tmp_path / "out.ply"), "--triangulate"]
    assert main([*program, "--method", "taubin"]) == 1
    assert "stay whole only in a file of the input's format" in capsys.readouterr().err
    (tmp_path / "in.ply").write_bytes(FILES["little.ply"])
    program[1] = str(tmp_path / "in.ply")
    assert main([*program, "--preset", "fast", "--confidence"]) == 1
    assert "the mesh has other faces" in capsys.readouterr().err
    assert not (tmp_path / "out.ply").exists()


def test_a_folder_of_them(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for name, data in FILES.items():
        (tmp_path / "in" / name).write_bytes(data)
    taubin = Filter("taubin", triangulate=True)
    outcomes = denoise_many(tmp_path / "in", tmp_path / "out", denoiser=taubin)
    assert [outcome.status for outcome in outcomes] == ["done"] * 5
    refused = denoise_many(tmp_path / "in", tmp_path / "other", denoiser=Filter("taubin"))
    assert [outcome.status for outcome in refused] == ["failed"] * 5
    assert all(isinstance(outcome.error, MeshError) for outcome in refused)


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        (
            "in.obj",
            b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\nf 1 2 3 9\n",
            r"face 1 \(line 6\) refers to vertex 9 of 4",
        ),
        (
            "in.obj",
            b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\nf 1 2\n",
            r"face 1 \(line 6\) has 2 corners",
        ),
        ("in.off", b"OFF\n4 1 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 7\n", "face 0 refers to vertex 7"),
        (
            "in.off",
            b"OFF\n4 1 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n5 0 1 2 3\n",
            "face 0 announces 5 corners and has 4",
        ),
        ("in.ply", FILES["little.ply"][:-60], "announces 37 face records and holds 35"),
        ("in.ply", FILES["ascii.ply"][:-60], "records"),
    ],
)
def test_damaged_files_are_named(tmp_path: Path, name: str, data: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(MeshError, match=message):
        load(tmp_path / name, triangulate=True)


# --- arrays ------------------------------------------------------------------------------------------


def test_pairs_come_back_with_their_own_faces() -> None:
    quads = np.array([face for face in FACES if len(face) == 4])
    arrays, rebuild = to_arrays((VERTICES, quads), triangulate=True)
    assert len(arrays.faces) == 2 * len(quads)
    moved, faces = rebuild(arrays.vertices + 1.0)
    assert np.array_equal(moved, VERTICES + 1.0)
    assert np.array_equal(faces, quads)
    _, faces = to_arrays((VERTICES, FACES), triangulate=True)[1](VERTICES)
    assert faces == FACES
    with pytest.raises(MeshError, match=re.escape("face 0 has 4 corners, not 3")) as caught:
        to_arrays((VERTICES, quads))
    assert "triangulate=True" in str(caught.value.hint)
    with pytest.raises(MeshError, match="face 1 refers to vertex 99"):
        to_arrays((VERTICES, [[0, 1, 2, 3], [0, 1, 99]]), triangulate=True)

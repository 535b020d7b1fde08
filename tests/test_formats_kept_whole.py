"""PLY files whose positions are whole numbers: types and values of these change, and all else stays byte for byte."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from gcnd.filters import apply_filter
from gcnd.mesh_io import load, save
from kept_cases import FACES, N_FACES, N_VERTICES, VERTICES, denoised

CORNERS = np.round(100 * VERTICES).astype(int)
MOVED = apply_filter((CORNERS.astype(np.float64), FACES), "taubin")[0]
QUAD = [0, 1, 2, 3]

HEADER = """ply
format {format} 1.0
comment property int x
obj_info of a  CT, in steps of 0.1 mm
element foo 1
property int x
element vertex {n_vertices}
property uchar flag
{x}
property short y
property list uchar int marks
  property  float  z
element face {n_faces}
property list uchar int vertex_indices
element grid 2
property list uchar int z
end_header
"""
TYPES = {"h": "short", "i": "int", "f": "float", "d": "double"}


def ply(kind: str, corners: np.ndarray, x: str, y: str, *, quads: int = 0, ragged: bool = False) -> bytes:
    """A file with x, y of the types with these struct codes; z is of type float from the start."""
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}.get(kind, "ascii")
    header = HEADER.format(
        format=name, x=f"property {TYPES[x]} x", n_vertices=N_VERTICES, n_faces=N_FACES + quads
    ).replace("property short y", f"property {TYPES[y]} y")
    rows: list[list[tuple[str, object]]] = [[("i", 2**31 - 1)]]
    for i, (a, b, c) in enumerate(corners.tolist()):
        marks = [-1] * (i % 3 if ragged else 2)
        rows.append([("B", i), (x, a), (y, b), ("B", len(marks)), *(("i", v) for v in marks), ("f", c)])
    for face in [*FACES.tolist(), *[QUAD] * quads]:
        rows.append([("B", len(face)), *(("i", corner) for corner in face)])
    rows += [[("B", 1), ("i", 13)], [("B", 0)]]
    if kind == "ascii":
        return (header + "".join(" ".join(str(v) for _, v in row) + "\n" for row in rows)).encode()
    return header.encode() + b"".join(struct.pack(kind + code, v) for row in rows for code, v in row)


@pytest.mark.parametrize("kind", ["ascii", "<", ">"])
@pytest.mark.parametrize("ragged", [False, True])
def test_all_but_positions_stays(tmp_path: Path, kind: str, ragged: bool) -> None:
    data = ply(kind, CORNERS, "i", "h", ragged=ragged)
    result = denoised(tmp_path, "a.ply", data)  # which checks that no strength gives the input back
    assert result == ply(kind, MOVED, "f", "f", ragged=ragged)


@pytest.mark.parametrize("kind", ["ascii", "<", ">"])
@pytest.mark.parametrize("line_end", ["\r\n", " \n"])
def test_other_line_ends_stay(tmp_path: Path, kind: str, line_end: str) -> None:
    def with_ends(data: bytes) -> bytes:
        head, end, rest = data.partition(b"end_header\n")
        return (head + end).replace(b"\n", line_end.encode()) + rest

    result = denoised(tmp_path, "a.ply", with_ends(ply(kind, CORNERS, "h", "i")))
    assert result == with_ends(ply(kind, MOVED, "f", "f"))


@pytest.mark.parametrize("kind", ["ascii", "<", ">"])
def test_beside_quads(tmp_path: Path, kind: str) -> None:
    (tmp_path / "a.ply").write_bytes(ply(kind, CORNERS, "i", "i", quads=2))
    mesh = load(tmp_path / "a.ply", triangulate=True)
    mesh.vertices = moved = CORNERS + 0.25
    save(mesh, tmp_path / "b.ply", like=tmp_path / "a.ply")
    assert (tmp_path / "b.ply").read_bytes() == ply(kind, moved, "f", "f", quads=2)


@pytest.mark.parametrize("is_binary", [False, True])
def test_behind_faces_and_beside_other_types(tmp_path: Path, is_binary: bool) -> None:
    kind = "binary_little_endian" if is_binary else "ascii"
    header = (
        f"ply\nformat {kind} 1.0\nelement face 2\nproperty list uchar int vertex_indices\nelement vertex 4\n"
    )
    header += "property uchar x\nproperty double y\nproperty int z\nend_header\n"
    faces = [(4, 0, 1, 2, 3), (3, 0, 1, 2)]

    def data(vertices: list[tuple[float, ...]], header: str, code: str) -> bytes:
        if not is_binary:
            return (header + "".join(" ".join(map(str, row)) + "\n" for row in [*faces, *vertices])).encode()
        rows = [struct.pack(f"<B{len(face) - 1}i", *face) for face in faces]
        return header.encode() + b"".join([*rows, *(struct.pack(code, *vertex) for vertex in vertices)])

    (tmp_path / "a.ply").write_bytes(
        data([(0, 0.1, 0), (9, 0.1, 0), (9, 9.1, 0), (0, 9.1, 0)], header, "<Bdi")
    )
    mesh = load(tmp_path / "a.ply", triangulate=True)
    mesh.vertices[2] = [9.5, 8.7, -0.5]
    save(mesh, tmp_path / "b.ply", like=tmp_path / "a.ply")
    expected = [(0, 0.1, 0), (9, 0.1, 0), (9.5, 8.7, -0.5), (0, 9.1, 0)]
    header = header.replace("uchar x", "float x").replace("int z", "float z")
    assert (tmp_path / "b.ply").read_bytes() == data(expected, header, "<fdf")


@pytest.mark.parametrize("kind", ["ascii", "<", ">"])
def test_large_whole_numbers_get_64_bits(tmp_path: Path, kind: str) -> None:
    far = CORNERS + np.array([2**25 + 1, 0, 0])
    (tmp_path / "a.ply").write_bytes(ply(kind, far, "i", "h"))
    mesh = load(tmp_path / "a.ply")
    moved = far + np.array([[0.25, 0, 0]] + [[0, 0, 0]] * (N_VERTICES - 1))
    mesh.vertices = moved
    save(mesh, tmp_path / "b.ply", like=tmp_path / "a.ply")
    assert np.array_equal(load(tmp_path / "b.ply").vertices, moved)
    assert b"property double x\nproperty double y\n" in (tmp_path / "b.ply").read_bytes()

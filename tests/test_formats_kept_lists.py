"""PLY files whose lists differ in length from record to record: read, and kept byte for byte."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gcnd.errors import MeshError
from gcnd.mesh_io import load
from kept_cases import EXPECTED, FACES, N_FACES, N_VERTICES, VERTICES, denoised

HEADER = """ply
format {format} 1.0
element foo 2
property list uchar int v
element vertex {n_vertices}
property float x
property list uchar short marks
property float y
property float z
element face {n_faces}
property list uchar int vertex_indices
property list uchar float texcoord
property uchar label
element last 3
property list ushort double w
end_header
"""

Record = list[tuple[str, Any]]


def records(*, even: str = "") -> list[Record]:
    """Each record as (struct code, value), lists as (codes of count and values, list)."""

    def length(name: str, row: int, longest: int) -> int:
        return longest if name == even or row % 2 else 0

    rows: list[Record] = [[("Bi", [1, 2, 3][: length("v", row + 1, 3)])] for row in range(2)]
    for row, (x, y, z) in enumerate(VERTICES.tolist()):
        rows.append([("f", x), ("Bh", [row, -row][: length("marks", row, 2)]), ("f", y), ("f", z)])
    for row, face in enumerate(FACES.tolist()):
        rows.append([("Bi", face), ("Bf", [0.5] * length("texcoord", row, 6)), ("B", row)])
    return [*rows, [("Hd", [])], [("Hd", [0.1, 2.0])], [("Hd", [7.0])]]


def ply(kind: str, rows: list[Record]) -> bytes:
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}.get(kind, "ascii")
    header = HEADER.format(format=name, n_vertices=N_VERTICES, n_faces=N_FACES).encode()
    if kind == "ascii":
        lines = [
            " ".join(" ".join(map(repr, [len(v), *v])) if len(code) == 2 else repr(v) for code, v in row)
            for row in rows
        ]
        return header + ("\n".join(lines) + "\n").encode()
    data = b""
    for row in rows:
        for code, v in row:
            if len(code) == 2:
                data += struct.pack(f"{kind}{code[0]}{len(v)}{code[1]}", len(v), *v)
            else:
                data += struct.pack(kind + code, v)
    return header + data


@pytest.mark.parametrize("kind", ["ascii", "<", ">"])
@pytest.mark.parametrize("even", ["", "marks", "texcoord", "v"])
def test_lists_of_changing_length_stay(tmp_path: Path, kind: str, even: str) -> None:
    rows = records(even=even)
    result = denoised(tmp_path, "a.ply", ply(kind, rows))
    moved = EXPECTED if kind == "ascii" else EXPECTED.astype(np.float32).astype(np.float64)
    for (x, y, z), row in zip(moved.tolist(), rows[2 : 2 + N_VERTICES], strict=True):
        row[0], row[2], row[3] = ("f", x), ("f", y), ("f", z)
    assert result == ply(kind, rows)


@pytest.mark.parametrize("triangulate", [False, True])
@pytest.mark.parametrize("kind", ["ascii", "<", ">"])
def test_other_values_are_read_beside_them(tmp_path: Path, kind: str, triangulate: bool) -> None:
    (tmp_path / "a.ply").write_bytes(ply(kind, records(even="marks")))
    mesh = load(tmp_path / "a.ply", triangulate=triangulate)
    assert np.array_equal(mesh.vertices, VERTICES)
    assert np.array_equal(mesh.faces, FACES)
    assert mesh.vertex_attributes["marks"].tolist() == [[row, -row] for row in range(N_VERTICES)]
    assert list(mesh.face_attributes) == ["label"]
    assert mesh.face_attributes["label"].tolist() == list(range(N_FACES))
    (tmp_path / "b.ply").write_bytes(ply(kind, records()))
    assert not load(tmp_path / "b.ply", triangulate=triangulate).vertex_attributes


@pytest.mark.parametrize("kind", ["ascii", "<", ">"])
def test_faults_beside_them_are_named(tmp_path: Path, kind: str) -> None:
    rows = records()
    (tmp_path / "cut.ply").write_bytes(ply(kind, rows[:-1]))
    with pytest.raises(MeshError, match="announces 3 last records and holds 2"):
        load(tmp_path / "cut.ply")
    third = 2 + N_VERTICES + 2
    rows[third][0] = ("Bi", [0, 1, 2, 3])
    (tmp_path / "quad.ply").write_bytes(ply(kind, rows))
    with pytest.raises(MeshError, match="face 2 has 4 corners, not 3"):
        load(tmp_path / "quad.ply")


@pytest.mark.parametrize("length", ["1.5", "nan", "-1", "5000"])
def test_a_length_that_is_none_is_named(tmp_path: Path, length: str) -> None:
    text = ply("ascii", records()).replace(b"\n0\n2 0.1 2.0\n", f"\n0\n{length} 0.1 2.0\n".encode())
    (tmp_path / "a.ply").write_bytes(text)
    with pytest.raises(MeshError, match=f"list 'w' of last 1 has length {length}"):
        load(tmp_path / "a.ply")

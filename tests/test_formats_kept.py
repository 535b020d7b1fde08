"""What `gcnd denoise` leaves of a file: everything but positions and normals, byte for byte or value for value."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np
import pytest

from gcnd.cli import main
from gcnd.errors import MeshError
from gcnd.filters import apply_filter
from gcnd.mesh_io import load, save
from kept_cases import (
    EXPECTED,
    FACES,
    N_FACES,
    N_VERTICES,
    NORMALS,
    RNG,
    VERTICES,
    assert_same,
    denoised,
    face_normals_of,
    normals_of,
)

# --- PLY ---------------------------------------------------------------------------------------------

PLY_HEADER = """ply
format {format} 1.0
comment VCGLIB generated, with  two spaces
obj_info scanned on a Tuesday
element camera 2
property double focal
property uchar id
element vertex {n_vertices}
property uchar flags
property {real} x
property {real} y
property {real} z
property float nx
property float ny
property float nz
property ushort red
property list uchar short marks
property double quality
element face {n_faces}
property list uchar int vertex_indices
property uint material
property float nx
property float ny
property float nz
element edge 2
property int vertex1
property int vertex2
comment the last one
end_header
"""


def ply_rows(real: str) -> dict[str, np.ndarray]:
    r = "f8" if real == "double" else "f4"
    camera = np.zeros(2, [("focal", "f8"), ("id", "u1")])
    camera["focal"], camera["id"] = [0.1, 35.5], [10, 13]
    normal = [("nx", "f4"), ("ny", "f4"), ("nz", "f4")]
    vertex = np.zeros(
        N_VERTICES,
        [("flags", "u1"), ("x", r), ("y", r), ("z", r), *normal, ("red", "u2"), ("n", "u1"), ("marks", "i2", (2,)),
         ("quality", "f8")],
    )  # fmt: skip
    vertex["n"], vertex["flags"], vertex["red"] = 2, 10, RNG.integers(0, 65536, N_VERTICES)
    vertex["marks"], vertex["quality"] = RNG.integers(-99, 99, (N_VERTICES, 2)), RNG.random(N_VERTICES)
    face = np.zeros(N_FACES, [("n", "u1"), ("vertex_indices", "i4", (3,)), ("material", "u4"), *normal])
    face["n"], face["vertex_indices"], face["material"] = 3, FACES, 2**32 - 5
    edge = np.array([(0, 1), (1, 2)], [("vertex1", "i4"), ("vertex2", "i4")])
    for axis in range(3):
        vertex["xyz"[axis]] = VERTICES[:, axis]
        vertex["n" + "xyz"[axis]] = NORMALS[:, axis]
        face["n" + "xyz"[axis]] = face_normals_of(VERTICES)[:, axis]
    return {"camera": camera, "vertex": vertex, "face": face, "edge": edge}


@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_binary_ply(tmp_path: Path, real: str, order: str, line_end: str) -> None:
    rows = {name: r.astype(r.dtype.newbyteorder(order)) for name, r in ply_rows(real).items()}
    endian = "binary_little_endian" if order == "<" else "binary_big_endian"
    header = PLY_HEADER.format(format=endian, real=real, n_vertices=N_VERTICES, n_faces=N_FACES)
    start = header.replace("\n", line_end).encode()
    result = denoised(tmp_path, "a.ply", start + b"".join(r.tobytes() for r in rows.values()))
    assert result.startswith(start)
    offset = len(start)
    found = {}
    for name, r in rows.items():
        found[name] = np.frombuffer(result, r.dtype, len(r), offset)
        offset += r.nbytes
    assert offset == len(result)
    for name, r in rows.items():
        changing = {"vertex": ("x", "y", "z", "nx", "ny", "nz"), "face": ("nx", "ny", "nz")}.get(name, ())
        for field in r.dtype.names or ():
            assert (found[name][field].tobytes() == r[field].tobytes()) is (field not in changing), field
    assert np.array_equal(
        np.column_stack([found["vertex"][a] for a in "xyz"]), EXPECTED.astype(found["vertex"]["x"].dtype)
    )
    for name, expected in (("vertex", normals_of(EXPECTED)), ("face", face_normals_of(EXPECTED))):
        assert np.abs(np.column_stack([found[name]["n" + a] for a in "xyz"]) - expected).max() < 1e-5


@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("line_end", ["\n", "\r\n", "  \n", "\n\n"])
def test_text_ply(tmp_path: Path, line_end: str, mark: bytes) -> None:
    header = PLY_HEADER.format(format="ascii", real="float", n_vertices=N_VERTICES, n_faces=N_FACES)
    lines = []
    for rows in ply_rows("float").values():
        for row in rows:
            lines.append(
                "  ".join(str(v) for cell in row.item() for v in np.ravel(np.asarray(cell)).tolist())
            )
    header = header if line_end == "\n\n" else header.replace("\n", line_end)
    data = mark + (header + "".join(line + line_end for line in lines)).encode()
    result = denoised(tmp_path, "A.PLY", data)
    before, after = (re.findall(rb"\S+|\s+", text) for text in (data, result))
    assert len(before) == len(after)
    changed = [i for i in range(len(before)) if before[i] != after[i]]
    first = next(i for i, word in enumerate(after) if word == b"end_header") + 2 + 8
    width = len(ply_rows("float")["vertex"][0].item()) + 1
    positions = [first + 2 * (width * v + 1 + axis) for v in range(N_VERTICES) for axis in range(6)]
    face_start = first + 2 * width * N_VERTICES
    of_faces = [face_start + 2 * (8 * f + 5 + axis) for f in range(N_FACES) for axis in range(3)]
    assert set(changed) <= {*positions, *of_faces}
    assert len(changed) > 0.95 * (len(positions) + len(of_faces))
    numbers = np.array([float(after[i]) for i in positions]).reshape(-1, 6)
    text_vertices = np.array([float(before[i]) for i in positions]).reshape(-1, 6)[:, :3]
    expected = apply_filter((text_vertices, FACES), "taubin")[0]
    assert np.array_equal(numbers[:, :3], expected)
    assert np.abs(numbers[:, 3:] - normals_of(expected)).max() < 1e-6


def test_ply_with_texture_seams_keeps_its_vertices(tmp_path: Path) -> None:
    texcoord = RNG.random((N_FACES, 6)).astype("<f4")
    header = (
        f"ply\nformat binary_little_endian 1.0\ncomment TextureFile maps/wood.png\nelement vertex {N_VERTICES}\n"
        "property float x\nproperty float y\nproperty float z\nproperty float nx\nproperty float ny\n"
        f"property float nz\nelement face {N_FACES}\nproperty list uchar int vertex_indices\n"
        "property list uchar float texcoord\nend_header\n"
    ).encode()
    face = np.zeros(N_FACES, [("n", "u1"), ("ids", "<i4", (3,)), ("m", "u1"), ("uv", "<f4", (6,))])
    face["n"], face["ids"], face["m"], face["uv"] = 3, FACES, 6, texcoord
    vertex = np.hstack([VERTICES, NORMALS]).astype("<f4")
    (tmp_path / "in" / "maps").mkdir(parents=True)
    (tmp_path / "in" / "maps" / "wood.png").write_bytes(b"a picture")
    result = denoised(tmp_path, "a.ply", header + vertex.tobytes() + face.tobytes())
    assert result.startswith(header)
    assert result.endswith(face.tobytes())
    found = np.frombuffer(result, "<f4", 6 * N_VERTICES, len(header)).reshape(-1, 6)
    assert np.array_equal(found[:, :3], EXPECTED.astype("<f4"))
    assert np.abs(found[:, 3:] - normals_of(EXPECTED)).max() < 1e-6
    assert (tmp_path / "maps" / "wood.png").read_bytes() == b"a picture"


# --- STL and OFF -------------------------------------------------------------------------------------


def test_binary_stl(tmp_path: Path) -> None:
    record = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    rows = np.zeros(N_FACES, record)
    rows["normal"], rows["corners"] = face_normals_of(VERTICES), VERTICES[FACES]
    rows["normal"][5] = 0.0
    rows["attribute"] = RNG.integers(0, 65536, N_FACES)
    header = b"solid COLOR=\x01\x02\x03\xff,MATERIAL=".ljust(80, b"\x07") + struct.pack("<I", N_FACES)
    result = denoised(tmp_path, "a.STL", header + rows.tobytes())
    assert result.startswith(header)
    found = np.frombuffer(result, record, N_FACES, 84)
    assert np.array_equal(found["attribute"], rows["attribute"])
    assert np.array_equal(found["corners"], EXPECTED.astype("f4")[FACES])
    expected = face_normals_of(EXPECTED)
    expected[5] = 0.0
    assert np.abs(found["normal"] - expected).max() < 1e-6


@pytest.mark.parametrize("line_end", ["\n", "\r\n", " \n\n"])
def test_text_stl(tmp_path: Path, line_end: str) -> None:
    lines = []
    for half, name in ((slice(0, 40), b"caf\xe9 left"), (slice(40, N_FACES), b"right")):
        lines.append(b"solid " + name)
        for corners, normal in zip(
            VERTICES[FACES[half]].tolist(), face_normals_of(VERTICES)[half].tolist(), strict=True
        ):
            lines.append(("  FACET  NORMAL " + " ".join(map(repr, normal))).encode())
            lines.append(b"outer loop")
            lines += [("\tvertex " + "  ".join(map(repr, corner))).encode() for corner in corners]
            lines += [b"endloop", b"endfacet"]
        lines.append(b"endsolid " + name)
    data = b"".join(line + line_end.encode() for line in lines)
    result = denoised(tmp_path, "a.stl", data)
    number = rb"-?\d+\.?\d*(?:e-?\d+)?"
    assert re.sub(number, b"0", result) == re.sub(number, b"0", data)
    corners = [line.split()[1:] for line in result.splitlines() if line.strip().startswith(b"vertex")]
    found = np.array(corners, dtype=float).reshape(-1, 3, 3)
    # Joined in another order, sums round otherwise.
    assert np.abs(found - EXPECTED[FACES]).max() < 1e-14
    normals = [line.split()[2:] for line in result.splitlines() if b"NORMAL" in line]
    assert np.abs(np.array(normals, dtype=float) - face_normals_of(EXPECTED)).max() < 1e-6


@pytest.mark.parametrize("kind", ["OFF", "COFF", "NOFF", "STCNOFF"])
@pytest.mark.parametrize(("line_end", "mark"), [("\n", b""), ("\r\n", b"\xef\xbb\xbf"), (" \n\n# no\n", b"")])
def test_off(tmp_path: Path, kind: str, line_end: str, mark: bytes) -> None:
    lines = [f"{kind} # a comment", f"{N_VERTICES} {N_FACES} 0"]
    for v in range(N_VERTICES):
        words = " ".join(map(repr, VERTICES[v].tolist()))
        words += "  " + " ".join(map(repr, NORMALS[v].tolist())) if "N" in kind else ""
        words += " 255 0 7 255" if "C" in kind else ""
        lines.append(words + (" 0.5 0.25" if "ST" in kind else "") + ("# first" if v == 0 else ""))
    lines += [f"3  {a} {b} {c} {f % 255} 0 0" for f, (a, b, c) in enumerate(FACES.tolist())]
    data = mark + line_end.join([*lines, ""]).encode()
    result = denoised(tmp_path, "a.off", data)
    before, after = (re.findall(rb"\S+|\s+", text) for text in (data, result))
    assert len(before) == len(after)
    changed = {i for i in range(len(before)) if before[i] != after[i]}
    assert len(changed) == N_VERTICES * (6 if "N" in kind else 3)
    assert np.array_equal(load(tmp_path / "a.off").vertices, EXPECTED)
    if "N" in kind:
        rows = [
            line.split()
            for line in result.decode("utf-8-sig").splitlines()
            if line.strip() and line[0] != "#"
        ]
        normals = np.array([row[3:6] for row in rows[2 : 2 + N_VERTICES]], dtype=float)
        assert np.abs(normals - normals_of(EXPECTED)).max() < 1e-6


# --- save(like=...) ----------------------------------------------------------------------------------


def test_like_must_be_the_file_of_the_mesh(tmp_path: Path) -> None:
    save((VERTICES, FACES), tmp_path / "a.ply")
    save((VERTICES, FACES[1:]), tmp_path / "other.ply")
    with pytest.raises(MeshError, match=r"other\.ply as PLY: it has other faces than the mesh"):
        save(load(tmp_path / "a.ply"), tmp_path / "out.ply", like=tmp_path / "other.ply")
    with pytest.raises(MeshError, match="is the input itself"):
        save(load(tmp_path / "a.ply"), tmp_path / "a.ply", like=tmp_path / "a.ply")
    assert not (tmp_path / "out.ply").exists()


def test_like_of_another_format(tmp_path: Path) -> None:
    save((VERTICES, FACES), tmp_path / "a.ply")
    save(load(tmp_path / "a.ply"), tmp_path / "a.off", like=tmp_path / "a.ply")
    assert np.array_equal(load(tmp_path / "a.off").vertices, VERTICES)


@pytest.mark.parametrize("extension", ["ply", "obj", "off", "stl", "glb"])
def test_a_folder_keeps_its_files_too(tmp_path: Path, extension: str) -> None:
    (tmp_path / "in").mkdir()
    name = f"a.{extension}"
    save((VERTICES, FACES), tmp_path / "in" / name)
    data = (tmp_path / "in" / name).read_bytes()
    if extension in ("ply", "obj"):
        data = data.replace(b"element vertex", b"comment of mine\nelement vertex")
        data = data if extension == "ply" else b"# of mine\n" + data
    (tmp_path / "in" / name).write_bytes(data)
    options = ["--method", "taubin", "--strength", "0", "--quiet"]
    assert main(["denoise", str(tmp_path / "in"), str(tmp_path / "out"), *options]) == 0
    assert_same(data, (tmp_path / "out" / name).read_bytes(), name)

"""What `gcnd denoise` leaves of a file: everything but positions and normals, byte for byte or value for value."""

from __future__ import annotations

import base64
import json
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from gcnd.cli import main
from gcnd.data.noise import add_noise
from gcnd.errors import MeshError
from gcnd.filters import apply_filter
from gcnd.mesh_io import load, save

BALL = trimesh.creation.icosphere(subdivisions=1)
FACES = np.array(BALL.faces)
VERTICES = add_noise(np.array(BALL.vertices), FACES.astype(np.uint32), level=0.3, seed=1).astype(np.float32)
VERTICES = VERTICES.astype(np.float64)
N_VERTICES, N_FACES = len(VERTICES), len(FACES)
RNG = np.random.default_rng(0)
NORMALS = np.array(trimesh.Trimesh(VERTICES, FACES, process=False).vertex_normals)
EXPECTED = apply_filter((VERTICES, FACES), "taubin")[0]


def normals_of(vertices: Any, faces: Any = FACES) -> np.ndarray:
    """An independent loop over the faces."""
    sums = np.zeros((len(vertices), 3))
    for face in np.asarray(faces):
        a, b, c = np.asarray(vertices)[face]
        for corner in face:
            sums[corner] += np.cross(b - a, c - a)
    return np.array([n / np.linalg.norm(n) for n in sums])


def face_normals_of(vertices: Any) -> np.ndarray:
    a, b, c = (np.asarray(vertices)[FACES[:, i]] for i in range(3))
    crosses = np.cross(b - a, c - a)
    return np.asarray(crosses / np.linalg.norm(crosses, axis=1, keepdims=True))


def denoised(tmp_path: Path, name: str, data: bytes, *options: str) -> bytes:
    """The result of the program; at no strength it must be the input, and the input must stay."""
    (tmp_path / "in").mkdir(exist_ok=True)
    (tmp_path / "in" / name).write_bytes(data)
    program = ["denoise", str(tmp_path / "in" / name), str(tmp_path / name), "--method", "taubin", "--quiet"]
    assert main([*program, "--strength", "0"]) == 0
    assert_same(data, (tmp_path / name).read_bytes(), name)
    assert main([*program, *options]) == 0
    assert (tmp_path / "in" / name).read_bytes() == data
    return (tmp_path / name).read_bytes()


def assert_same(before: bytes, after: bytes, name: str) -> None:
    if not name.lower().endswith(".glb"):
        assert before == after
        return
    assert glb_parts(before) == glb_parts(after)


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


# --- OBJ ---------------------------------------------------------------------------------------------


def obj_text() -> str:
    lines = ["# made by hand", "mtllib parts.mtl", "o thing", ""]
    lines += [f"v {x!r} {y!r}  {z!r} 0.25 0.5 1.0 " for x, y, z in VERTICES.tolist()]
    lines += [f"vn {x:.6f} {y:.6f} {z:.6f}" for x, y, z in NORMALS.tolist()]
    lines += [f"vt {u:.4f} {v:.4f} 0" for u, v in RNG.random((30, 2)).tolist()]
    for f, (a, b, c) in enumerate((FACES + 1).tolist()):
        if f % 20 == 0:
            lines += [
                f"g part{f} all",
                f"usemtl {'red' if f % 40 else 'Blue Steel'}",
                f"s {'off' if f == 40 else f}",
            ]
        t = f % 28 + 1
        if f == 7:
            a, b, c, t = a - N_VERTICES - 1, b - N_VERTICES - 1, c - N_VERTICES - 1, t
            lines.append(f"f {a}/{t}/{a} {b}/{t + 1}/{b} {c}/{t + 2}/{c}")
        else:
            lines.append(f"  f {a}/{t}/{a} {b}/{t + 1}/{b} \\\n {c}/{t + 2}/{c}  # face {f}")
    return "\n".join([*lines, "l 1 2", "p 3", "vp 0.1", "cstype bezier", ""])


@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_obj(tmp_path: Path, line_end: str, mark: bytes) -> None:
    (tmp_path / "in").mkdir()
    library = (
        b"newmtl red\nKd 1 0 0\nmap_Kd -s 1 1 1 wood.png\nnewmtl Blue Steel\nmap_Bump deep/steel map.png\n"
    )
    referred = {"parts.mtl": library, "wood.png": b"wood", "deep/steel map.png": b"steel"}
    for name, content in referred.items():
        (tmp_path / "in" / name).parent.mkdir(exist_ok=True)
        (tmp_path / "in" / name).write_bytes(content)
    data = mark + obj_text().replace("\n", line_end).encode() + b"# caf\xe9"
    result = denoised(tmp_path, "a.OBJ", data)
    before, after = data.split(b"\n"), result.split(b"\n")
    assert len(before) == len(after)
    vertices, normals = [], []
    for old, new in zip(before, after, strict=True):
        if old.startswith(b"v "):
            vertices.append([float(word) for word in new.split()[1:4]])
            assert old.split()[4:] == new.split()[4:]
            assert re.findall(rb"\s+", old) == re.findall(rb"\s+", new)
        elif old.startswith(b"vn "):
            normals.append([float(word) for word in new.split()[1:4]])
        else:
            assert old == new
    assert np.array_equal(vertices, EXPECTED)
    assert np.abs(np.array(normals) - normals_of(EXPECTED)).max() < 1e-6
    for name, content in referred.items():
        assert (tmp_path / name).read_bytes() == content


def test_obj_normals_by_face_and_negative_normal_indices(tmp_path: Path) -> None:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in VERTICES.tolist()]
    for (a, b, c), n in zip((FACES + 1).tolist(), face_normals_of(VERTICES).tolist(), strict=True):
        lines += ["vn " + " ".join(map(repr, n)), f"f {a}//-1 {b}//-1 {c}//-1"]
    result = denoised(tmp_path, "a.obj", "\n".join(lines).encode()).decode()
    found = [line.split()[1:] for line in result.splitlines() if line.startswith("vn")]
    assert np.abs(np.array(found, dtype=float) - face_normals_of(EXPECTED)).max() < 1e-6
    assert [line for line in result.splitlines() if line[0] == "f"] == [
        line for line in lines if line[0] == "f"
    ]


def test_another_file_of_a_referred_name_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "parts.mtl").write_bytes(b"newmtl red\n")
    (tmp_path / "parts.mtl").write_bytes(b"something else")
    (tmp_path / "in" / "a.obj").write_text(obj_text())
    mesh = load(tmp_path / "in" / "a.obj")
    with pytest.raises(MeshError, match=r"parts\.mtl is another file than"):
        save(mesh, tmp_path / "a.obj", like=tmp_path / "in" / "a.obj")
    assert (tmp_path / "parts.mtl").read_bytes() == b"something else"
    assert not (tmp_path / "a.obj").exists()


def test_references_that_lead_out_of_the_folder_are_not_followed(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "out" / "deep").mkdir(parents=True)
    (tmp_path / "secret.mtl").write_bytes(b"newmtl red\n")
    (tmp_path / "in" / "a.obj").write_text(obj_text().replace("parts.mtl", "../secret.mtl"))
    save(load(tmp_path / "in" / "a.obj"), tmp_path / "out" / "deep" / "a.obj", like=tmp_path / "in" / "a.obj")
    assert [path.name for path in (tmp_path / "out").rglob("*")] == ["deep", "a.obj"]


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


# --- GLB ---------------------------------------------------------------------------------------------


def glb_parts(data: bytes) -> tuple[dict[str, Any], bytes]:
    n_json = int.from_bytes(data[12:16], "little")
    return json.loads(data[20 : 20 + n_json]), data[20 + n_json + 8 :]


def rich_glb() -> bytes:
    """Two materials over one mesh, a second buffer, interleaved data, nested nodes, a texture, extras, an animation."""
    half = N_FACES // 2
    interleaved = np.zeros(N_VERTICES, [("p", "<f4", (3,)), ("n", "<f4", (3,)), ("uv", "<f4", (2,))])
    interleaved["p"], interleaved["n"], interleaved["uv"] = VERTICES, NORMALS, RNG.random((N_VERTICES, 2))
    picture = b"\x89PNG not really a picture"
    first = interleaved.tobytes() + FACES.astype("<u2").tobytes()
    binary = first + picture + b"\0" * (-len(first + picture) % 4)
    data_uri = "data:application/octet-stream;base64,"
    second = RNG.random((N_VERTICES, 4)).astype("<f4").tobytes()
    stride, n_vertex_bytes = 32, interleaved.nbytes
    views = [
        {"buffer": 0, "byteOffset": 0, "byteLength": n_vertex_bytes, "byteStride": stride, "name": "all"},
        {"buffer": 0, "byteOffset": n_vertex_bytes, "byteLength": 6 * N_FACES},
        {"buffer": 0, "byteOffset": len(first), "byteLength": len(picture)},
        {"buffer": 1, "byteLength": len(second)},
    ]
    accessors: list[dict[str, Any]] = [
        {"bufferView": 0, "componentType": 5126, "count": N_VERTICES, "type": "VEC3",
         "min": VERTICES.min(axis=0).tolist(), "max": VERTICES.max(axis=0).tolist()},
        {"bufferView": 0, "byteOffset": 12, "componentType": 5126, "count": N_VERTICES, "type": "VEC3"},
        {"bufferView": 0, "byteOffset": 24, "componentType": 5126, "count": N_VERTICES, "type": "VEC2"},
        {"bufferView": 1, "componentType": 5123, "count": 3 * half, "type": "SCALAR"},
        {"bufferView": 1, "byteOffset": 6 * half, "componentType": 5123, "count": 3 * (N_FACES - half),
         "type": "SCALAR"},
        {"bufferView": 3, "componentType": 5126, "count": N_VERTICES, "type": "VEC4"},
    ]  # fmt: skip
    attributes = {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2, "COLOR_0": 5}
    header = {
        "asset": {"version": "2.0", "generator": "Größe", "extras": {"unit": "mm"}},
        "scene": 0,
        "scenes": [{"nodes": [0], "name": "main"}],
        "nodes": [
            {"children": [1], "translation": [10.0, 0.5, -2.25], "extras": {"tag": [1, 2.5, None]}},
            {"mesh": 0, "rotation": [0.0, 0.6, 0.0, 0.8], "scale": [2.0, 2.0, 2.0], "name": "ball"},
        ],
        "meshes": [{"name": "two halves", "primitives": [
            {"attributes": attributes, "indices": 3, "material": 0},
            {"attributes": attributes, "indices": 4, "material": 1, "extras": {"half": True}},
        ]}],
        "materials": [
            {"name": "a", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0.1}},
            {"name": "b", "doubleSided": True, "extensions": {"KHR_materials_unlit": {}}},
        ],
        "extensionsUsed": ["KHR_materials_unlit"],
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [{"wrapS": 33071}],
        "images": [{"bufferView": 2, "mimeType": "image/png"}],
        "buffers": [
            {"byteLength": len(first + picture)},
            {"byteLength": len(second), "uri": data_uri + base64.b64encode(second).decode()},
        ],
        "bufferViews": views,
        "accessors": accessors,
    }  # fmt: skip
    text = json.dumps(header, indent=1, ensure_ascii=False).encode()
    text += b" " * (-len(text) % 4)
    length = 12 + 8 + len(text) + 8 + len(binary)
    chunks = (
        struct.pack("<I", len(text)) + b"JSON" + text + struct.pack("<I", len(binary)) + b"BIN\0" + binary
    )
    return b"glTF" + struct.pack("<II", 2, length) + chunks


def test_glb(tmp_path: Path) -> None:
    data = rich_glb()
    result = denoised(tmp_path, "a.GLB", data)
    assert int.from_bytes(result[8:12], "little") == len(result)
    (before, old), (after, new) = glb_parts(data), glb_parts(result)
    dtype = np.dtype([("p", "<f4", (3,)), ("n", "<f4", (3,)), ("uv", "<f4", (2,))])
    old_rows, new_rows = (np.frombuffer(content, dtype, N_VERTICES) for content in (old, new))
    assert np.array_equal(old_rows["uv"], new_rows["uv"])
    assert old[old_rows.nbytes :] == new[new_rows.nbytes :]
    # Turned, scaled and moved, a filter does the same.
    assert np.abs(new_rows["p"] - EXPECTED).max() < 1e-5
    assert np.abs(new_rows["n"] - normals_of(new_rows["p"])).max() < 1e-5
    for bound, values in (("min", new_rows["p"].min(axis=0)), ("max", new_rows["p"].max(axis=0))):
        assert np.array_equal(np.array(after["accessors"][0].pop(bound), dtype="f4"), values)
        assert before["accessors"][0].pop(bound) != values.tolist()
    assert after == before


def test_glb_placed_twice_gets_one_shape(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    mesh = trimesh.Trimesh(VERTICES, FACES, process=False)
    scene.add_geometry(mesh, geom_name="ball")
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    mirror[:3, 3] = [5.0, 0.0, 0.0]
    scene.graph.update(frame_to="other", geometry="ball", matrix=mirror)
    denoised(tmp_path, "a.glb", scene.export(file_type="glb"))
    result = load(tmp_path / "a.glb")
    assert len(result.vertices) == 2 * N_VERTICES
    assert np.abs(result.vertices[:N_VERTICES] - EXPECTED).max() < 1e-6
    assert np.abs(result.vertices[N_VERTICES:] - (EXPECTED * [-1, 1, 1] + [5, 0, 0])).max() < 1e-6


def test_the_whole_scene_is_read_as_trimesh_reads_it(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    scene = trimesh.Scene()
    for i in range(3):
        part = trimesh.Trimesh(VERTICES + i, FACES[i:], process=False)
        scene.add_geometry(part, transform=trimesh.transformations.random_rotation_matrix(rng.random(3)))
    (tmp_path / "a.glb").write_bytes(scene.export(file_type="glb"))
    ours, theirs = load(tmp_path / "a.glb", shape_only=True), load(tmp_path / "a.glb")
    assert np.array_equal(ours.faces, theirs.faces)
    assert np.abs(ours.vertices - theirs.vertices).max() < 1e-12


def test_a_glb_whose_data_are_elsewhere_or_too_short(tmp_path: Path) -> None:
    header, binary = glb_parts(rich_glb())
    for buffers, message in [
        ([{"byteLength": 9, "uri": "far.bin"}, header["buffers"][1]], r"data are in another file, far\.bin"),
        ([header["buffers"][0], {"byteLength": 3, "uri": "data:;base64,AAAA"}], None),
        ([{"byteLength": 3, "uri": "data:;base64,AAAA"}, header["buffers"][1]], "reaches beyond its buffer"),
    ]:
        text = json.dumps({**header, "buffers": buffers}).encode()
        text += b" " * (-len(text) % 4)
        chunks = (
            struct.pack("<I", len(text)) + b"JSON" + text + struct.pack("<I", len(binary)) + b"BIN\0" + binary
        )
        (tmp_path / "a.glb").write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks)
        if message is None:  # what is too short there is not the shape
            assert len(load(tmp_path / "a.glb", shape_only=True).faces) == N_FACES
        else:
            with pytest.raises(MeshError, match=message):
                load(tmp_path / "a.glb", shape_only=True)


# --- save(like=...) ----------------------------------------------------------------------------------


def test_like_must_be_the_file_of_the_mesh(tmp_path: Path) -> None:
    save((VERTICES, FACES), tmp_path / "a.ply")
    save((VERTICES, FACES[1:]), tmp_path / "other.ply")
    with pytest.raises(MeshError, match=r"other\.ply as PLY: it has other faces than the mesh"):
        save(load(tmp_path / "a.ply"), tmp_path / "out.ply", like=tmp_path / "other.ply")
    with pytest.raises(MeshError, match="is the input itself"):
        save(load(tmp_path / "a.ply"), tmp_path / "a.ply", like=tmp_path / "a.ply")
    assert not (tmp_path / "out.ply").exists()


def test_like_of_another_format_and_whole_numbers(tmp_path: Path) -> None:
    save((VERTICES, FACES), tmp_path / "a.ply")
    save(load(tmp_path / "a.ply"), tmp_path / "a.off", like=tmp_path / "a.ply")
    assert np.array_equal(load(tmp_path / "a.off").vertices, VERTICES)
    header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty int x\nproperty int y\nproperty int z\n"
    header += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    (tmp_path / "i.ply").write_text(header + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    mesh = load(tmp_path / "i.ply")
    mesh.vertices += 0.25
    save(mesh, tmp_path / "o.ply", like=tmp_path / "i.ply")
    assert load(tmp_path / "o.ply").vertices[0].tolist() == [0.25, 0.25, 0.25]


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

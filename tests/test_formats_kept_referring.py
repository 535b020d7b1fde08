"""Formats that refer to materials and textures, written again with other positions: OBJ and GLB."""

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

from gcnd.errors import MeshError
from gcnd.formats.referred import check_copies
from gcnd.mesh_io import load, save
from kept_cases import (
    EXPECTED,
    FACES,
    N_FACES,
    N_VERTICES,
    NORMALS,
    RNG,
    VERTICES,
    denoised,
    face_normals_of,
    glb_parts,
    normals_of,
)

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


# --- GLB ---------------------------------------------------------------------------------------------


def glb(header: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(header, indent=1, ensure_ascii=False).encode()
    text += b" " * (-len(text) % 4)
    length = 12 + 8 + len(text) + 8 + len(binary)
    chunks = (
        struct.pack("<I", len(text)) + b"JSON" + text + struct.pack("<I", len(binary)) + b"BIN\0" + binary
    )
    return b"glTF" + struct.pack("<II", 2, length) + chunks


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
    return glb(header, binary)


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


@pytest.mark.parametrize("images", [[7], "x", {"uri": "a.png"}])
def test_a_glb_with_images_that_are_none_is_refused_before_the_work(tmp_path: Path, images: Any) -> None:
    header, binary = glb_parts(rich_glb())
    source = tmp_path / "a.glb"
    source.write_bytes(glb({**header, "images": images}, binary))
    with pytest.raises(MeshError, match=r"cannot read .*a\.glb"):
        check_copies(source, tmp_path / "b.glb")


def test_a_glb_whose_data_are_elsewhere_or_too_short(tmp_path: Path) -> None:
    header, binary = glb_parts(rich_glb())
    for buffers, message in [
        (
            [{**header["buffers"][0], "uri": "far.bin"}, header["buffers"][1]],
            r"data are in another file, far\.bin",
        ),
        (
            [header["buffers"][0], {"byteLength": 3, "uri": "data:;base64,AAAA"}],
            r"end of view \d and holds 3",
        ),
        (
            [{"byteLength": 3, "uri": "data:;base64,AAAA"}, header["buffers"][1]],
            r"end of view \d and holds 3",
        ),
        (
            [{**header["buffers"][0], "uri": "data:;base64,AAAA"}, header["buffers"][1]],
            "reaches beyond its buffer",
        ),
    ]:
        text = json.dumps({**header, "buffers": buffers}).encode()
        text += b" " * (-len(text) % 4)
        chunks = (
            struct.pack("<I", len(text)) + b"JSON" + text + struct.pack("<I", len(binary)) + b"BIN\0" + binary
        )
        (tmp_path / "a.glb").write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks)
        with pytest.raises(MeshError, match=message):
            load(tmp_path / "a.glb", shape_only=True)

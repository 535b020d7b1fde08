"""GLB: scenes, what trimesh would misread, colours and attributes."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gcnd.cli import main
from gcnd.errors import MeshError
from gcnd.mesh_io import load, save

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
TWO_FACES = np.array([[0, 1, 2], [0, 2, 3]])


def written(tmp_path: Path, name: str, content: bytes) -> Path:
    path = tmp_path / name
    path.write_bytes(content)
    return path


def glb_of(scene: trimesh.Scene) -> bytes:
    data: bytes = scene.export(file_type="glb")
    return data


def edited_glb(data: bytes, **changes: object) -> bytes:
    """The same file with keys of its JSON header replaced."""
    n_json = int.from_bytes(data[12:16], "little")
    header = {**json.loads(data[20 : 20 + n_json]), **changes}
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + n_json :]
    return b"glTF" + struct.pack("<IIII", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest


def test_scene_of_one_mesh_is_placed(tmp_path: Path) -> None:
    mirror = np.diag([-2.0, 1.0, 1.0, 1.0])
    mirror[:3, 3] = [10, 20, 30]
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.Trimesh(SQUARE, TWO_FACES, process=False), transform=mirror)
    mesh = load(written(tmp_path, "a.glb", glb_of(scene)))
    assert np.array_equal(mesh.vertices, SQUARE * [-2, 1, 1] + [10, 20, 30])
    assert mesh.faces.tolist() == [[0, 2, 1], [0, 3, 2]]
    assert np.allclose(mesh.face_normals, [[0, 0, 1], [0, 0, 1]])


def test_instances_come_in_the_order_of_the_file(tmp_path: Path) -> None:
    data = glb_of(trimesh.Scene(trimesh.Trimesh(SQUARE, TWO_FACES, process=False)))
    nodes = [{"mesh": 0, "translation": [x, 0, 0]} for x in (10, 20, 30)]
    path = written(tmp_path, "a.glb", edited_glb(data, nodes=nodes, scenes=[{"nodes": [0, 1, 2]}]))
    assert load(path).vertices[::4, 0].tolist() == [10, 20, 30]


def test_a_node_without_a_way_back_is_refused_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = glb_of(trimesh.Scene(trimesh.Trimesh(SQUARE, TWO_FACES, process=False)))
    nodes = [{"scale": [1, 1, 0], "children": [1]}, {"mesh": 0, "name": "a sheet"}]
    source = written(tmp_path, "a.glb", edited_glb(data, nodes=nodes, scenes=[{"nodes": [0]}]))
    assert main(["denoise", str(source), str(tmp_path / "b.glb"), "--method", "taubin"]) == 1
    told = capsys.readouterr().err
    assert "node 1 ('a sheet') makes its mesh flat" in told
    assert "taubin (" not in told
    # What needs no way back is no worse for it.
    assert main(["denoise", str(source), str(tmp_path / "b.ply"), "--method", "taubin", "-q"]) == 0
    assert main(["info", str(source)]) == 0
    small = [{"mesh": 0, "scale": [1e-9, 1e-9, 1e-12]}]
    source = written(tmp_path, "a.glb", edited_glb(data, nodes=small, scenes=[{"nodes": [0]}]))
    assert main(["denoise", str(source), str(tmp_path / "b.glb"), "--method", "taubin", "-q"]) == 0


def test_names_that_no_file_can_have_stay(tmp_path: Path) -> None:
    data = glb_of(trimesh.Scene(trimesh.Trimesh(SQUARE, TWO_FACES, process=False)))
    images = [{"uri": "\ud800.png", "name": "\ud800"}, {"uri": "Größe.png"}]
    source, out = written(tmp_path, "a.glb", edited_glb(data, images=images)), tmp_path / "b.glb"
    report = tmp_path / "report.json"
    assert main(["denoise", str(source), str(out), "--method", "taubin", "--report", str(report), "-q"]) == 0
    data = out.read_bytes()
    assert json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])["images"] == images


def test_scene_is_joined_only_without_loss(tmp_path: Path) -> None:
    parts = [trimesh.Trimesh(SQUARE + i, TWO_FACES, process=False) for i in range(2)]
    path = tmp_path / "a.glb"
    path.write_bytes(glb_of(trimesh.Scene(parts)))
    mesh = load(path)
    assert np.array_equal(mesh.vertices, np.concatenate([SQUARE, SQUARE + 1]))
    assert np.array_equal(mesh.faces, np.concatenate([TWO_FACES, TWO_FACES + 4]))
    parts[1].visual.vertex_colors = [1, 2, 3, 255]
    path.write_bytes(glb_of(trimesh.Scene(parts)))
    with pytest.raises(MeshError, match=r"2 meshes that do not fit into one: .* different colours") as caught:
        load(path)
    assert "join the parts" in (caught.value.hint or "")
    for part, color in zip(parts, ([255, 0, 0, 255], [0, 255, 0, 255]), strict=True):
        material = trimesh.visual.material.PBRMaterial(baseColorFactor=color)
        part.visual = trimesh.visual.TextureVisuals(uv=np.zeros((4, 2)), material=material)
    path.write_bytes(glb_of(trimesh.Scene(parts)))
    with pytest.raises(MeshError, match="different materials"):
        load(path)
    parts[1].visual.material = parts[0].visual.material
    path.write_bytes(glb_of(trimesh.Scene(parts)))
    joined = load(path)
    assert joined.visual.uv.shape == (8, 2)
    assert joined.visual.material.baseColorFactor.tolist() == [255, 0, 0, 255]


def test_glb_that_trimesh_would_misread_is_refused(tmp_path: Path) -> None:
    data = glb_of(trimesh.Scene(trimesh.Trimesh(SQUARE, TWO_FACES, process=False)))
    for changes, message in [
        ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "extension KHR_draco_mesh_compression"),
        ({"extensionsRequired": ["KHR_mesh_quantization"]}, "extension KHR_mesh_quantization"),
        ({"accessors": [{"sparse": {}}]}, "sparse accessors"),
        ({"meshes": [{"primitives": [{"mode": 1}]}]}, "primitive 0 of mesh 0 holds lines, not triangles"),
        ({"meshes": [{"primitives": [{}, {"mode": 6}]}]}, "primitive 1 of mesh 0 holds a triangle fan"),
        ({"nodes": [], "scenes": [{"nodes": []}]}, "holds no mesh"),
    ]:
        with pytest.raises(MeshError, match=message):
            load(written(tmp_path, "a.glb", edited_glb(data, **changes)))
    unharmed = edited_glb(data, extensionsRequired=["KHR_materials_unlit"])
    assert np.array_equal(load(written(tmp_path, "b.glb", unharmed)).vertices, SQUARE)


def test_glb_colours_and_attributes_survive(tmp_path: Path) -> None:
    mesh = trimesh.Trimesh(SQUARE, TWO_FACES, process=False)
    mesh.visual.vertex_colors = np.arange(16, dtype=np.uint8).reshape(4, 4)
    mesh.vertex_attributes["_quality"] = np.array([1, 2, 3, 4], dtype=np.float32)
    save(mesh, tmp_path / "a.glb")
    again = load(tmp_path / "a.glb")
    assert np.array_equal(again.visual.vertex_colors, mesh.visual.vertex_colors)
    assert again.vertex_attributes["_quality"].ravel().tolist() == [1, 2, 3, 4]

"""OBJ: vertex order, indices, seams and materials."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gcnd.cli import main
from gcnd.errors import MeshError
from gcnd.mesh_io import load, save, to_arrays

VERTICES = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 9 9 9\n"
SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [9, 9, 9]])


def obj(tmp_path: Path, content: str) -> Path:
    path = tmp_path / "a.obj"
    path.write_text(content)
    return path


@pytest.mark.parametrize(
    "faces",
    [
        "f 1 2 3\nf 1 3 4\n",
        "f 1// 2// 3//\nf 1// 3// 4//\n",
        "f 1//7 2//8 3//9\nf 1//1 3//2 4//3\n",
        "f 1/ 2/ 3/\nf 1 3 4 # comment\n",
        "f -5 -4 -3\nf -5 -3 -2\n",
        "g part\ns 1\nf 1 2 3\ng other\ns off\n\tf 1\t3 \\\n 4\n",
        "l 1 2\np 3\nf 1 2 3\nf 1 3 4\n",
    ],
)
def test_every_way_to_write_two_faces(tmp_path: Path, faces: str) -> None:
    """Vertex 4 is unused and normals differ per corner; neither changes the order or the number."""
    mesh = load(obj(tmp_path, VERTICES + "vn 0 0 1\n" * 9 + faces))
    assert np.array_equal(mesh.vertices, SQUARE)
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_windows_line_endings_and_exponents(tmp_path: Path) -> None:
    mesh = load(obj(tmp_path, "v 1e-3 -2.5E+2 0\r\nv 1 0 0\r\nv 0 1 0\r\nf 1 2 3\r\n"))
    assert mesh.vertices[0].tolist() == [1e-3, -250.0, 0.0]


def test_negative_indices_count_from_where_they_stand(tmp_path: Path) -> None:
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nf -3 -2 -1\nv 5 0 0\nv 6 0 0\nv 5 1 0\nf -3 -2 -1\n"
    assert load(obj(tmp_path, text)).faces.tolist() == [[0, 1, 2], [3, 4, 5]]
    with pytest.raises(MeshError, match=r"face 0 \(line 4\) refers to vertex"):
        load(obj(tmp_path, text.replace("f -3 -2 -1", "f -4 -2 -1", 1)))


def test_colours_survive(tmp_path: Path) -> None:
    mesh = trimesh.Trimesh(SQUARE, [[0, 1, 2], [0, 2, 3]], process=False)
    colors = np.random.default_rng(0).integers(0, 256, (5, 3))
    mesh.visual.vertex_colors = colors
    save(mesh, tmp_path / "b.obj")
    assert np.array_equal(load(tmp_path / "b.obj").visual.vertex_colors[:, :3], colors)


def test_seam_repeats_a_vertex_behind_all_others(tmp_path: Path) -> None:
    uv = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1 0.7\nvt 0.5 0.5\n"
    mesh = load(obj(tmp_path, VERTICES + uv + "f 1/1 2/2 3/3\nf 1/5 3/3 4/4\n"))
    assert np.array_equal(mesh.vertices, SQUARE[[0, 1, 2, 3, 4, 0]])
    assert mesh.faces.tolist() == [[0, 1, 2], [5, 2, 3]]
    assert mesh.visual.uv.tolist() == [[0, 0], [1, 0], [1, 1], [0, 1], [0, 0], [0.5, 0.5]]
    save(mesh, tmp_path / "b.obj")
    again = load(tmp_path / "b.obj")
    assert np.array_equal(again.faces, mesh.faces)
    assert np.array_equal(again.visual.uv, mesh.visual.uv)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("f 1 2 3\nf 1 2 3 4\n", r"face 1 \(line 7\) has 4 corners, not 3"),
        ("f 1 2\n", r"face 0 \(line 6\) has 2 corners, not 3"),
        ("f 1 2 6\n", r"face 0 \(line 6\) refers to vertex 6 of 5"),
        ("f 0 1 2\n", r"refers to vertex 0 of 5"),
        ("f 1/1 2/1 3/1\n", "refers to texture coordinate 1 of 0"),
        ("f 1 2 x\n", "has a corner 'x', which is no index"),
        ("v 1 2\nf 1 2 3\n", r"vertex 5 \(line 6\) has 2 coordinates, not 3"),
        ("v 1 2 z\nf 1 2 3\n", r"vertex 5 \(line 6\) is not made of numbers: '1 2 z'"),
        ("v 1 2 nan\nf 1 2 3\n", "vertex 5 is not finite"),
    ],
)
def test_faults_are_named_with_their_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(MeshError, match=message):
        load(obj(tmp_path, VERTICES + text))


def test_material_and_its_texture_travel_along(tmp_path: Path) -> None:
    image_module = pytest.importorskip("PIL.Image")
    (tmp_path / "in").mkdir()
    (tmp_path / "out").mkdir()
    image_module.new("RGB", (2, 2), (10, 200, 30)).save(tmp_path / "in" / "wood.jpg")
    (tmp_path / "in" / "a.mtl").write_text("newmtl wood\nKd 1 0 0\nmap_Kd wood.jpg\n")
    text = "mtllib a.mtl\n" + VERTICES + "vt 0 0\nvt 1 0\nvt 1 1\nusemtl wood\nf 1/1 2/2 3/3\n"
    arrays, rebuild = to_arrays(load(obj(tmp_path / "in", text)))
    before = {path.name: path.read_bytes() for path in (tmp_path / "in").iterdir()}
    mesh = rebuild(arrays.vertices + 1.0)
    assert mesh.visual.material.image.size == (2, 2)
    save(mesh, tmp_path / "out" / "clean.obj")
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["clean.mtl", "clean.obj", "clean_texture.jpg"]
    # Copied, not encoded again.
    assert (tmp_path / "out" / "clean_texture.jpg").read_bytes() == before["wood.jpg"]
    again = load(tmp_path / "out" / "clean.obj")
    assert again.visual.material.image.size == (2, 2)
    assert again.visual.material.diffuse.tolist() == [255, 0, 0, 255]
    save(mesh, tmp_path / "in" / "other.obj")
    assert all((tmp_path / "in" / name).read_bytes() == data for name, data in before.items())
    save(mesh, tmp_path / "out" / "clean.ply")
    assert b"comment TextureFile ../in/wood.jpg\n" in (tmp_path / "out" / "clean.ply").read_bytes()
    save(mesh, tmp_path / "in" / "clean.ply")
    assert load(tmp_path / "in" / "clean.ply").visual.material.image.size == (2, 2)


def test_missing_material_costs_only_the_look(tmp_path: Path) -> None:
    text = "mtllib gone.mtl\n" + VERTICES + "vt 0 0\nvt 1 0\nvt 1 1\nusemtl wood\nf 1/1 2/2 3/3\n"
    mesh = load(obj(tmp_path, text))
    assert mesh.visual.uv[:3].tolist() == [[0, 0], [1, 0], [1, 1]]


@pytest.mark.skipif(os.name == "nt", reason="links need a right there")
def test_a_library_that_is_a_link_to_itself_costs_only_the_look(tmp_path: Path) -> None:
    (tmp_path / "loop.mtl").symlink_to("loop.mtl")
    source, out = obj(tmp_path, "mtllib loop.mtl\n" + VERTICES + "usemtl wood\nf 1 2 3\n"), tmp_path / "b.obj"
    assert main(["noise", str(source), str(out), "--level", "0"]) == 0
    assert np.array_equal(load(out).vertices, SQUARE)


def test_several_materials_are_kept_by_reference(tmp_path: Path) -> None:
    (tmp_path / "a.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n")
    faces = "usemtl red\nf 1 2 3\nusemtl blue\nf 1 3 4\nf 2 3 4\nusemtl red\nf 1 2 4\n"
    mesh = load(obj(tmp_path, "mtllib a.mtl\n" + VERTICES + "f 4 3 2\n" + faces))
    # Faces stay in the file's order, though materials come and go.
    assert mesh.faces.tolist() == [[3, 2, 1], [0, 1, 2], [0, 2, 3], [1, 2, 3], [0, 1, 3]]
    assert mesh.face_attributes["material_id"].tolist() == [-1, 0, 1, 1, 0]
    assert mesh.metadata["materials"] == ["red", "blue"]
    (tmp_path / "out").mkdir()
    save(mesh, tmp_path / "out" / "b.obj")
    lines = (tmp_path / "out" / "b.obj").read_text().splitlines()
    assert lines[0] == "mtllib ../a.mtl"
    assert lines[-8:] == [
        "f 4 3 2", "usemtl red", "f 1 2 3", "usemtl blue", "f 1 3 4", "f 2 3 4", "usemtl red", "f 1 2 4",
    ]  # fmt: skip
    again = load(tmp_path / "out" / "b.obj")
    assert again.face_attributes["material_id"].tolist() == [-1, 0, 1, 1, 0]


def test_other_files_that_have_the_names_of_material_and_texture_stay(tmp_path: Path) -> None:
    image_module = pytest.importorskip("PIL.Image")
    material = trimesh.visual.material.SimpleMaterial(image=image_module.new("RGB", (2, 2), (10, 200, 30)))
    mesh = trimesh.Trimesh(SQUARE[:4], [[0, 1, 2], [0, 2, 3]], process=False)
    mesh.visual = trimesh.visual.TextureVisuals(uv=SQUARE[:4, :2], material=material)
    others = {"t.mtl": b"precious", "t_texture.png": b"", "t_texture_2.png": b"too"}
    for name, content in others.items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "t_2.mtl").symlink_to(tmp_path / "gone.mtl")
    for _ in range(2):  # what an earlier run has written is used again
        save(mesh, tmp_path / "t.obj")
        assert {name: (tmp_path / name).read_bytes() for name in others} == others
        new = {path.name for path in tmp_path.iterdir()} - set(others)
        assert new == {"t.obj", "t_2.mtl", "t_3.mtl", "t_texture_3.png"}
    assert not (tmp_path / "gone.mtl").exists()
    assert "mtllib t_3.mtl\n" in (tmp_path / "t.obj").read_text()
    assert load(tmp_path / "t.obj").visual.material.image.getpixel((0, 0)) == (10, 200, 30)


@pytest.mark.parametrize(
    ("line", "names"),
    [
        ("a.mtl b.mtl", ["a.mtl", "b.mtl"]),
        ("my own.mtl  deep/b.mtl", ["my own.mtl", "deep/b.mtl"]),
        ("a b.mtl", ["a b.mtl"]),
        ("gone b.MTL", ["b.MTL"]),
        (" ".join(["gone.mtl"] * 60 + ["b.mtl"]), ["b.mtl"]),
    ],
)
def test_several_libraries_on_a_line(tmp_path: Path, line: str, names: list[str]) -> None:
    (tmp_path / "out").mkdir()
    for number, name in enumerate(names):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        # The last one has the material that is in use.
        (tmp_path / name).write_text(f"newmtl m{len(names) - 1 - number}\nKd 0 0 1\n")
    source = obj(tmp_path, f"mtllib {line}\n{VERTICES}usemtl m0\nf 1 2 3\n")
    mesh = load(source)
    assert mesh.visual.material.diffuse.tolist() == [0, 0, 255, 255]
    save(mesh, tmp_path / "out" / "b.obj", like=source)
    for name in names:
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / name).read_bytes()


@pytest.mark.parametrize("mark", ["\u2028", "\x0b", "\x0c", "\x85"])
def test_a_name_with_an_odd_space_ends_no_line(tmp_path: Path, mark: str) -> None:
    source = obj(tmp_path, f"mtllib a.mtl{mark}v 9 9 9\n" + VERTICES + "f 1 2 3\n")
    before = source.read_bytes()
    mesh = load(source)
    assert len(mesh.vertices) == VERTICES.count("v ")
    save(mesh, tmp_path / "b.obj", like=source)
    lines = (tmp_path / "b.obj").read_bytes().split(b"\n")
    assert lines[0] == before.split(b"\n")[0]
    assert len(load(tmp_path / "b.obj").vertices) == len(mesh.vertices)

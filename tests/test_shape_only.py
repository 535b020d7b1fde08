"""What only a result could not hold, commands that look at a mesh take; `gcnd noise` takes what `gcnd denoise` does."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import gcnd
from gcnd import _geom
from gcnd.cli import main
from gcnd.data.noise import add_noise
from gcnd.data.pairs import PairFiles, load_pair
from gcnd.errors import MeshError
from gcnd.mesh_io import load, read_shape, save, to_arrays
from gcnd.metrics import normal_error
from gcnd.same_faces import split_alike

COLORS = ([255, 0, 0, 255], [0, 255, 0, 255])
SQUARES = np.array([[x, y, 0.0] for y in (0, 1, 2) for x in (0, 1, 2, 3)], dtype=np.float64)
QUADS = [[a, a + 1, a + 5, a + 4] for a in (0, 1, 2, 4, 5, 6)]


def header_of(path: Path) -> dict[str, Any]:
    data = path.read_bytes()
    header: dict[str, Any] = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    return header


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Two balls of different materials in one GLB file, the second one placed by its node."""
    scene = trimesh.Scene()
    for number, color in enumerate(COLORS):
        ball = trimesh.creation.icosphere(subdivisions=2, radius=1.0 - 0.1 * number)
        material = trimesh.visual.material.PBRMaterial(baseColorFactor=color)
        ball.visual = trimesh.visual.TextureVisuals(uv=np.zeros((len(ball.vertices), 2)), material=material)
        scene.add_geometry(ball, transform=trimesh.transformations.translation_matrix([3.0 * number, 0, 0]))
    path = tmp_path / "scene.glb"
    path.write_bytes(scene.export(file_type="glb"))
    with pytest.raises(MeshError, match="different materials"):
        load(path)
    return path


def write_quads(path: Path, vertices: np.ndarray, faces: list[list[int]] = QUADS) -> Path:
    if path.suffix == ".obj":
        lines = [f"v {x} {y} {z}" for x, y, z in vertices.tolist()]
        lines += ["f " + " ".join(str(v + 1) for v in face) for face in faces]
    elif path.suffix == ".off":
        lines = ["OFF", f"{len(vertices)} {len(faces)} 0", *(f"{x} {y} {z}" for x, y, z in vertices.tolist())]
        lines += [" ".join(map(str, [len(face), *face])) for face in faces]
    else:
        lines = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
        lines += [f"property double {axis}" for axis in "xyz"]
        lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
        lines += [f"{x} {y} {z}" for x, y, z in vertices.tolist()]
        lines += [" ".join(map(str, [len(face), *face])) for face in faces]
    path.write_text("\n".join(lines) + "\n")
    return path


def sheared(by: float) -> np.ndarray:
    """The squares made lozenges: the sign says which diagonal of each is the shorter."""
    return SQUARES + np.outer(SQUARES[:, 1], [by, 0.0, 0.0])


# --- several materials -------------------------------------------------------------------------------


def test_info_of_several_materials(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(scene), "--json"]) == 0
    printed = capsys.readouterr()
    info = json.loads(printed.out)
    assert (info["faces"], info["components"], info["watertight"]) == (640, 2, True)
    assert info["bounding_box_diagonal"] == pytest.approx(np.sqrt(4.9**2 + 2**2 + 2**2), rel=0.02)
    assert printed.err == ""


def test_noise_evaluation_and_view_of_several_materials(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    noisy, clean, page = tmp_path / "noisy.glb", tmp_path / "clean.glb", tmp_path / "view.html"
    assert main(["noise", str(scene), str(noisy), "--level", "0.2", "--seed", "4"]) == 0
    truth = read_shape(scene).arrays
    moved = add_noise(truth.vertices, truth.faces, kind="gaussian", level=0.2, seed=4)
    assert np.abs(read_shape(noisy).arrays.vertices - moved).max() < 1e-6
    for key in ("materials", "nodes", "scenes"):
        assert header_of(noisy)[key] == header_of(scene)[key]

    assert main(["denoise", str(noisy), str(clean), "--method", "taubin", "--quiet"]) == 0
    capsys.readouterr()
    errors = []
    for path in (noisy, clean):
        assert main(["evaluate", str(path), str(scene), "--json", "--samples", "1000"]) == 0
        errors.append(json.loads(capsys.readouterr().out)["normal_error_degrees"])
    expected = normal_error(read_shape(noisy).arrays.vertices, truth.vertices, truth.faces)
    assert errors[0] == pytest.approx(expected)
    assert errors[1] < 0.8 * errors[0]

    view = ["view", str(clean), "--against", str(noisy), "--truth", str(scene), "--out", str(page), "--json"]
    assert main(view) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["faces"] == 640
    assert [figures["e_a_before"], figures["e_a_after"]] == pytest.approx(errors, rel=1e-6)
    assert page.stat().st_size > 400_000


def test_a_scan_of_several_materials(scene: Path, tmp_path: Path) -> None:
    noisy, truth = tmp_path / "noisy.ply", tmp_path / "truth.ply"
    assert main(["noise", str(scene), str(noisy), "--kind", "kinect1", "--truth", str(truth)]) == 0
    vertices, clean, faces = load_pair(PairFiles(noisy, truth))
    assert len(faces) > 100
    assert np.linalg.norm(clean - [1.5, 0, 0], axis=1).max() < 2.51
    assert np.abs(vertices - clean).max() > 0


def test_another_format_for_several_materials_is_refused(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["noise", str(scene), str(tmp_path / "noisy.ply"), "--level", "0.2"]) == 1
    assert "different materials" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["scene.glb"]


def test_a_shape_has_the_faces_of_the_whole_mesh(tmp_path: Path) -> None:
    """Strips in data of another file, at two places of which one is mirrored: corner by corner as with materials."""
    corners = np.random.default_rng(0).normal(size=(7, 3)).astype("<f4")
    (tmp_path / "corners.bin").write_bytes(corners.tobytes())
    header = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 84, "uri": "corners.bin"}],
        "bufferViews": [{"buffer": 0, "byteLength": 84}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 7, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": 5}]}],
        "nodes": [{"mesh": 0, "scale": [-1, 1, 1]}, {"mesh": 0, "translation": [5, 0, 0]}],
        "scenes": [{"nodes": [0, 1]}],
    }
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    sizes = [size.to_bytes(4, "little") for size in (2, 20 + len(text), len(text))]
    path = tmp_path / "strip.glb"
    path.write_bytes(b"glTF" + b"".join(sizes) + b"JSON" + text)
    whole, shape = to_arrays(path)[0], read_shape(path)
    assert shape.polygons is None
    assert np.array_equal(shape.arrays.faces, whole.faces)
    assert np.array_equal(shape.arrays.vertices, whole.vertices)
    assert len(whole.faces) == 10


# --- faces of more than three corners ----------------------------------------------------------------


@pytest.mark.parametrize("name", ["a.obj", "a.off", "a.ply"])
def test_info_of_quads(tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    path = write_quads(tmp_path / name, SQUARES)
    assert main(["info", str(path), "--json"]) == 0
    printed = capsys.readouterr()
    info = json.loads(printed.out)
    assert (info["vertices"], info["faces"], info["boundary_edges"]) == (12, 12, 10)
    assert printed.err.startswith(f"the 6 faces of {path} are counted as 12 triangles")


@pytest.mark.parametrize("name", ["obj", "off", "ply"])
def test_quads_split_in_different_ways_are_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    noisy = write_quads(tmp_path / f"noisy.{name}", sheared(-0.2) + np.array([0, 0, 0.1]))
    clean = write_quads(tmp_path / f"clean.{name}", sheared(0.2))
    triangles = [read_shape(path).arrays.faces for path in (noisy, clean)]
    assert not np.array_equal(*triangles)
    assert main(["evaluate", str(noisy), str(clean), "--json", "--samples", "100"]) == 0
    assert json.loads(capsys.readouterr().out)["normal_error_degrees"] == 0.0
    page = tmp_path / "view.html"
    assert main(["view", str(clean), "--against", str(noisy), "--out", str(page), "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["faces"] == 12
    assert figures["angle_mean"] == 0.0
    edge = _geom.mean_edge_length(sheared(-0.2), triangles[0])
    furthest = np.linalg.norm(sheared(0.2) - sheared(-0.2) - [0, 0, 0.1], axis=1).max() / edge
    assert figures["displacement_max"] == pytest.approx(furthest)


def test_pairs_with_quads_are_shown(tmp_path: Path) -> None:
    out = tmp_path / "view.html"
    figures = gcnd.view((sheared(0.2), QUADS), against=(sheared(-0.2), QUADS), out=out)
    assert figures.faces == 12
    assert figures.angle_max == 0.0


@pytest.mark.parametrize(
    ("faces", "message"),
    [
        (QUADS[:-1], "a has 5 faces and b has 6"),
        ([*QUADS[:2], [2, 3, 7], *QUADS[3:]], r"face 2 is \(2, 3, 7\) in a and \(2, 3, 7, 6\) in b"),
        ([*QUADS[:2], [2, 6, 7, 3], *QUADS[3:]], r"face 2 is \(2, 6, 7, 3\) in a and \(2, 3, 7, 6\) in b"),
    ],
)
def test_other_polygons_are_named(faces: list[list[int]], message: str) -> None:
    with pytest.raises(MeshError, match=message):
        split_alike(read_shape((SQUARES, faces)), read_shape((SQUARES, QUADS)), ("a", "b"))


@pytest.mark.parametrize("name", ["in.obj", "in.off", "in.ply"])
@pytest.mark.parametrize("kind", ["gaussian", "print"])
def test_noise_takes_quads_and_writes_them_whole(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, kind: str
) -> None:
    source = write_quads(tmp_path / name, SQUARES)
    out = tmp_path / f"noisy{source.suffix}"
    noise = ["noise", str(source), str(out), "--kind", kind]
    noise += ["--level", "0.1"] if kind == "gaussian" else []
    assert main(noise) == 1
    told = capsys.readouterr().err
    assert "has 4 corners, not 3" in told
    assert "gcnd noise --triangulate" in told
    assert main([*noise, "--triangulate"]) == 0
    found, expected = read_shape(out), read_shape(source)
    assert found.polygons is not None
    assert found.n_faces == 6
    assert np.array_equal(split_alike(found, expected, ("out", "in")).faces, expected.arrays.faces)
    assert np.abs(found.arrays.vertices - SQUARES).max() > 0.01
    other = tmp_path / ("noisy.ply" if source.suffix != ".ply" else "noisy.obj")
    assert main([*noise[:2], str(other), *noise[3:], "--triangulate"]) == 1
    assert "stay whole only in a file of the input's format" in capsys.readouterr().err


def test_noise_keeps_what_the_file_has(tmp_path: Path) -> None:
    source = tmp_path / "in.obj"
    (tmp_path / "in.mtl").write_text("newmtl red\n")
    ball = trimesh.creation.icosphere(subdivisions=1)
    save((ball.vertices, ball.faces), source)
    source.write_text("mtllib in.mtl\no ball\n" + source.read_text() + "# the end\n")
    out = tmp_path / "out" / "noisy.obj"
    out.parent.mkdir()
    assert main(["noise", str(source), str(out), "--level", "0.2"]) == 0
    lines = [
        [line for line in p.read_text().splitlines() if not line.startswith("v ")] for p in (source, out)
    ]
    assert lines[0] == lines[1]
    assert (out.parent / "in.mtl").read_text() == "newmtl red\n"

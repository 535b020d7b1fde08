"""Files of every kind, mutated; see `fuzz_cases`."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from functools import cache
from pathlib import Path

import numpy as np
import trimesh
import wild
from fuzz_checks import finite, refusals
from fuzz_surface import tiny_weights
from PIL import Image
from wild import Rng

import gcnd
from gcnd.compare.rows import Row, RowFile
from gcnd.errors import ConfigError, GcndError, MeshError, WeightsError
from gcnd.filters import apply_filter
from gcnd.mesh_io import load, save
from gcnd.train.report import read_log
from gcnd.weights import load_cascade, registry


@cache
def seed_files(extension: str) -> tuple[bytes, ...]:
    """Whole files of a format, of several kinds each, to be mutated."""
    ball = trimesh.creation.icosphere(subdivisions=1)
    colored = trimesh.Trimesh(ball.vertices, ball.faces, process=False)
    colored.visual.vertex_colors = np.arange(4 * len(ball.vertices), dtype=np.uint8).reshape(-1, 4)
    colored.vertex_attributes["quality"] = np.linspace(0, 1, len(ball.vertices)).astype(np.float32)
    colored.face_attributes["label"] = np.arange(len(ball.faces), dtype=np.int32)
    textured = trimesh.Trimesh(ball.vertices, ball.faces, process=False)
    picture = Image.fromarray(np.arange(48, dtype=np.uint8).reshape(4, 4, 3))
    textured.visual = trimesh.visual.TextureVisuals(
        uv=np.array(ball.vertices[:, :2]), material=trimesh.visual.material.SimpleMaterial(image=picture)
    )
    if extension == ".ply":
        text = b"""ply
format ascii 1.0
comment TextureFile wood.png
element vertex 4
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
element face 4
property list uchar int vertex_indices
property list uchar float texcoord
element edge 1
property int vertex1
property int vertex2
end_header
0 0 0 255 0 0
1 0 0 0 255 0
0 1 0 0 0 255
0 0 1 1 2 3
3 0 2 1 6 0 0 1 0 0 1
3 0 1 3 6 0 0 1 0 0 1
3 0 3 2 6 0 0 1 0 0 1
3 1 2 3 6 0 0 1 0 0 .5
0 1
"""
        return (text, text, *(_saved(mesh, extension) for mesh in (ball, colored, textured)))
    if extension == ".obj":
        text = (
            b"# made by hand\nmtllib a.mtl\no ball\n"
            + b"".join(b"v %d %d %d\n" % tuple(p) for p in ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)))
            + b"vt 0 0\nvt 1 0\nvt 0.5 1\nvn 0 0 1\ng a\nusemtl red\nf 1/1/1 3/2/1 2/3/1\nf 1//1 2//1 4//1\n"
            + b"usemtl blue\nf -4 -1 -2\nf 2/1 3/2 4/3\nl 1 2\n"
        )
        return (text, text, *(_saved(mesh, extension) for mesh in (colored, textured)))
    if extension == ".stl":
        far = trimesh.Trimesh(ball.vertices + 1e7, ball.faces, process=False)
        return tuple(_saved(mesh, extension) for mesh in (ball, far))
    if extension == ".off":
        text = (
            b"OFF\n# by hand\n4 4 6\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
            b"3 0 2 1 255 0 0\n3 0 1 3 0 255 0\n3 0 3 2 1 2 3\n3 1 2 3 9 9 9\n"
        )
        return (text, *(_saved(mesh, extension) for mesh in (ball, colored)))
    return tuple(_saved(mesh, extension) for mesh in (ball, colored, textured))


def _saved(mesh: trimesh.Trimesh, extension: str) -> bytes:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"mesh{extension}"
        save(mesh, path)
        return path.read_bytes()


def mesh_file(extension: str, rng: Rng, folder: Path) -> bool:
    files = seed_files(extension)
    path = folder / f"mutated{extension}"
    path.write_bytes(wild.mutated(rng, files[wild.below(rng, len(files))]))
    with refusals(MeshError):
        mesh = load(path)
    finite(mesh.vertices)
    assert len(mesh.faces)
    assert mesh.faces.min() >= 0
    assert mesh.faces.max() < len(mesh.vertices)
    # What was read can be worked on, and written.
    with refusals(GcndError):
        save(apply_filter(mesh, "laplacian", iterations=1), folder / f"written{extension}")
    finite(load(folder / f"written{extension}").vertices)
    return True


def weights_file(rng: Rng, folder: Path) -> bool:
    path = folder / "mutated.safetensors"
    data = tiny_weights(folder).read_bytes()
    header = 8 + int.from_bytes(data[:8], "little")
    if rng.random() < 0.7:
        # The header is a twentieth of the file; faults in it tell more than faults in the weights.
        data = wild.mutated(rng, data[8:header]) + data[header:]
        size = len(data) - (tiny_weights(folder).stat().st_size - header)
        data = (size if rng.random() < 0.9 else wild.below(rng, 1 << 40)).to_bytes(8, "little") + data
    else:
        data = wild.mutated(rng, data)
    path.write_bytes(data)
    with refusals(WeightsError):
        cascade = load_cascade(str(path))
    for tensor in cascade.state_dict().values():
        finite(tensor.detach().double().numpy())
    ball = trimesh.creation.icosphere(subdivisions=1)
    with refusals(GcndError):
        vertices, _ = gcnd.denoise(
            (np.array(ball.vertices), ball.faces), preset=str(path), precision="float32"
        )
    finite(vertices)
    return True


def card_file(rng: Rng, folder: Path) -> bool:
    card = json.loads((registry._FOLDER / "fast.json").read_bytes())
    card["sha256"] = hashlib.sha256(tiny_weights(folder).read_bytes()).hexdigest()
    text = json.dumps(card).encode()
    shipped = folder / "shipped"
    shipped.mkdir(exist_ok=True)
    (shipped / "tiny.safetensors").write_bytes(tiny_weights(folder).read_bytes())
    (shipped / "tiny.json").write_bytes(wild.mutated(rng, text))
    before = registry._FOLDER, registry._SHIPPED
    registry._FOLDER, registry._SHIPPED = shipped, ("tiny",)
    try:
        with refusals(WeightsError):
            (found,) = registry.list_models()
        with refusals(WeightsError):
            load_cascade("tiny")
    finally:
        registry._FOLDER, registry._SHIPPED = before
    assert isinstance(found.sha256, str)
    return True


def log_file(rng: Rng, folder: Path) -> bool:
    line = {
        "time": 1.5,
        "stage": 1,
        "step": 100,
        "loss": 0.1,
        "patches_per_second": 9.0,
        "validation_e_a": 3.0,
    }
    text = "".join(json.dumps(line | {"step": step}) + "\n" for step in range(100, 500, 100))
    (folder / "log.jsonl").write_bytes(wild.mutated(rng, text.encode()))
    with refusals(ConfigError):
        assert read_log(folder)
    return True


def rows_file(rng: Rng, folder: Path) -> bool:
    row = Row(
        "k",
        "cube",
        "cad",
        "normal",
        "0.1",
        768,
        "taubin",
        "taubin",
        "gcnd",
        "1",
        {"x": 1},
        None,
        1.5,
        e_a=3.25,
    )
    line = json.dumps(asdict(row)).encode() + b"\n"
    path = folder / "rows.jsonl"
    path.write_bytes(wild.mutated(rng, line * 3))
    with refusals(ConfigError):
        RowFile(path)
    return True

"""A noisy ball, its result, and what is to be the same in a file written again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from gcnd.cli import main
from gcnd.data.noise import add_noise
from gcnd.filters import apply_filter

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


def glb_parts(data: bytes) -> tuple[dict[str, Any], bytes]:
    n_json = int.from_bytes(data[12:16], "little")
    return json.loads(data[20 : 20 + n_json]), data[20 + n_json + 8 :]


def assert_same(before: bytes, after: bytes, name: str) -> None:
    if not name.lower().endswith(".glb"):
        assert before == after
        return
    assert glb_parts(before) == glb_parts(after)

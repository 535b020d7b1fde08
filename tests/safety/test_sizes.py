"""Files that claim to be huge are refused at once; what would not fit in memory is told before the work."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from fuzz_surface import tiny_cascade, tiny_weights

import gcnd
from gcnd import filters, memory, predict
from gcnd.errors import MeshError, WeightsError
from gcnd.filters import apply_filter
from gcnd.mesh_io import load, save
from gcnd.meshes.arrays import checked
from gcnd.predict import PatchPredictor
from gcnd.weights import load_cascade
from gcnd.weights.files import load_tensors, save_tensors

HUGE = 10**12

PLY_HEAD = (
    "ply\nformat {format} 1.0\nelement vertex {v}\nproperty float x\nproperty float y\nproperty float z\n"
)
PLY_TAIL = "element face {f}\nproperty list uchar int vertex_indices\nend_header\n"


def glb(header: dict[str, Any], data: bytes = b"") -> bytes:
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    chunk = b"" if not data else len(data).to_bytes(4, "little") + b"BIN\0" + data
    body = len(text).to_bytes(4, "little") + b"JSON" + text + chunk
    return b"glTF" + (2).to_bytes(4, "little") + (12 + len(body)).to_bytes(4, "little") + body


def huge_glb(**accessor: Any) -> bytes:
    position = {"componentType": 5126, "type": "VEC3", "count": HUGE, "bufferView": 0} | accessor
    return glb(
        {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "accessors": [{name: value for name, value in position.items() if value is not None}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}],
            "buffers": [{"byteLength": 36}],
        },
        bytes(36),
    )


CLAIMS: dict[str, tuple[str, bytes]] = {
    "text ply, vertices": (
        ".ply", (PLY_HEAD.format(format="ascii", v=HUGE) + PLY_TAIL.format(f=1) + "0 0 0\n").encode()
    ),
    "text ply, faces": (
        ".ply",
        (PLY_HEAD.format(format="ascii", v=1) + PLY_TAIL.format(f=HUGE) + "0 0 0\n3 0 0 0\n").encode(),
    ),
    "ply, vertices": (
        ".ply",
        (PLY_HEAD.format(format="binary_little_endian", v=HUGE) + PLY_TAIL.format(f=1)).encode() + bytes(64),
    ),
    "ply, faces": (
        ".ply",
        (PLY_HEAD.format(format="binary_big_endian", v=1) + PLY_TAIL.format(f=HUGE)).encode() + bytes(64),
    ),
    "ply, elements without properties": (
        ".ply", f"ply\nformat binary_little_endian 1.0\nelement vertex {HUGE}\nend_header\n".encode()
    ),
    "stl": (".stl", bytes(80) + (2**32 - 1).to_bytes(4, "little") + bytes(500)),
    "off, vertices": (".off", f"OFF\n{HUGE} 1 0\n0 0 0\n3 0 0 0\n".encode()),
    "off, faces": (".off", f"OFF\n1 {HUGE} 0\n0 0 0\n3 0 0 0\n".encode()),
    "obj": (".obj", f"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 {HUGE}\n".encode()),
    "glb": (".glb", huge_glb()),
    "glb without data": (".glb", huge_glb(bufferView=None)),
    "glb, 10⁹ without data": (".glb", huge_glb(bufferView=None, count=10**9)),
    "glb of a huge length": (".glb", b"glTF" + (2).to_bytes(4, "little") + b"\xff\xff\xff\xff" + bytes(100)),
}  # fmt: skip


def test_the_same_file_with_honest_numbers_is_read(tmp_path: Path) -> None:
    corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype="<f4").tobytes()
    (tmp_path / "a.glb").write_bytes(huge_glb(count=3).replace(bytes(36), corner))
    assert len(load(tmp_path / "a.glb").faces) == 1


@pytest.mark.skipif(sys.platform != "linux", reason="the address space is limited on Linux")
def test_claims_of_10_to_the_12_are_refused_at_once_in_little_memory(tmp_path: Path) -> None:
    for number, (extension, data) in enumerate(CLAIMS.values()):
        (tmp_path / f"{number}{extension}").write_bytes(data)
    config = tiny_cascade().config.to_dict()
    config["stages"][0]["network"]["static_channels"] = [60000, 60000, 60000]
    tensors, header = load_tensors(tiny_weights(tmp_path))
    save_tensors(tmp_path / "huge.safetensors", tensors, header | {"cascade": config})
    code = """
import json, resource, sys, time
from pathlib import Path
import gcnd.weights, trimesh, PIL.Image
from gcnd.errors import GcndError
from gcnd.mesh_io import load
used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + (256 << 20),) * 2)
told = {}
for path in sorted(Path(sys.argv[1]).iterdir()):
    since = time.process_time()
    try:
        gcnd.weights.load_cascade(str(path)) if path.suffix == ".safetensors" else load(path)
        told[path.name] = ["was read", 0.0]
    except GcndError as error:
        told[path.name] = [str(error), time.process_time() - since]
print(json.dumps(told))
"""
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told.pop("tiny.safetensors") == ["was read", 0.0]
    assert len(told) == len(CLAIMS) + 1
    for name, (message, seconds) in told.items():
        assert re.search("cannot read|does not fit its own description", message), f"{name}: {message}"
        assert "Memory" not in message, f"{name}: {message}"
        assert "allocate" not in message, f"{name}: {message}"
        assert seconds < 1.0, f"{name}: {seconds} s"


def test_a_mesh_placed_a_million_times_is_foreseen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save(trimesh.creation.icosphere(subdivisions=2), tmp_path / "a.glb")
    data = (tmp_path / "a.glb").read_bytes()
    size = int.from_bytes(data[12:16], "little")
    header = json.loads(data[20 : 20 + size])
    (mesh_node,) = [node for node in header["nodes"] if "mesh" in node]
    children = [len(header["nodes"]) + number for number in range(300)]
    header["nodes"] += [mesh_node] * 300
    header["scenes"][0]["nodes"] += children
    (tmp_path / "b.glb").write_bytes(glb(header, data[20 + size + 8 :]))
    assert len(load(tmp_path / "b.glb").faces) >= 300 * 320
    monkeypatch.setattr(memory, "available_bytes", lambda: 20_000_000)
    assert len(load(tmp_path / "a.glb").faces) == 320
    with pytest.raises(MeshError, match=r"faces need about 0\.1 GB of memory, and 0\.0 GB are free"):
        load(tmp_path / "b.glb")
    with pytest.raises(MeshError, match=r"faces need about 0\.1 GB of memory, and 0\.0 GB are free"):
        load(tmp_path / "b.glb", shape_only=True)


def test_memory_that_is_missing_is_told_before_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    monkeypatch.setattr(memory, "available_bytes", lambda: 100_000)
    told: list[str] = []
    with pytest.raises(MeshError, match=r"1,280 faces need about .* GB are free") as caught:
        apply_filter(ball, "taubin", progress=lambda _, stage: told.append(stage))
    assert caught.value.hint is not None
    assert "taubin" not in told
    monkeypatch.setattr(memory, "available_bytes", lambda: None)
    assert len(apply_filter(ball, "taubin").faces) == 1280


def test_batches_are_halved_until_those_of_all_threads_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "available_bytes", lambda: 80_000_000)
    # A fourth is 20 MB: 4,096 nodes of 5,000 bytes are 20.5 MB.
    assert [memory.nodes_that_fit(4096, 64, 5000, threads) for threads in (1, 2, 8)] == [2048, 1024, 256]
    assert memory.nodes_that_fit(4096, 64, 4000, 1) == 4096
    assert memory.nodes_that_fit(4096, 64, 10**9, 1) == 64
    monkeypatch.setattr(memory, "available_bytes", lambda: None)
    assert memory.nodes_that_fit(4096, 64, 10**9, 1) == 4096


def test_a_mesh_is_denoised_in_smaller_batches_where_memory_is_short(monkeypatch: pytest.MonkeyPatch) -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    batches: list[int] = []

    class Watched(PatchPredictor):
        def __init__(self, *args: Any) -> None:
            super().__init__(*args)
            batches.append(self.batch)

    monkeypatch.setattr(predict, "PatchPredictor", Watched)
    results = []
    for free in (None, 1_000_000):
        monkeypatch.setattr(memory, "available_bytes", lambda free=free: free)
        results.append(gcnd.denoise(ball, preset="fast").vertices)
    assert set(batches[:3]) == {64}
    assert set(batches[3:]) == {1}
    np.testing.assert_allclose(*results, rtol=0, atol=1e-4)


@pytest.mark.parametrize(
    ("method", "parameters"), [("l0", {}), ("tgv", {}), ("low-rank", {"patch_size": 512})]
)
def test_what_filters_take_beyond_the_usual_is_told_before_the_work(
    method: str, parameters: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    # Enough for a filter that takes no more than the network, and too little for these.
    monkeypatch.setattr(memory, "available_bytes", lambda: 1_000_000)
    assert len(apply_filter(ball, "taubin").faces) == 1280
    told: list[str] = []
    with pytest.raises(MeshError, match=r"1,280 faces need about .* GB are free"):
        apply_filter(ball, method, **parameters, progress=lambda _, stage: told.append(stage))
    assert method not in told


def tangled(method: str) -> tuple[np.ndarray, np.ndarray]:
    """No ordinary surface: what the system takes is not seen from the number of faces, but from its pattern."""
    order = np.random.default_rng(1)
    if method == "l0":  # a strip that jumps from vertex to vertex
        strip = np.concatenate([order.permutation(3000) for _ in range(3)])
        return order.normal(size=(3000, 3)), np.stack([strip[:-2], strip[1:-1], strip[2:]], axis=1)
    if method == "bilateral-normal-implicit":  # a fan, each of whose faces is every other's neighbour
        rim = np.arange(500)
        fan = np.stack([np.zeros(500, int), 1 + rim, 1 + (rim + 1) % 500], axis=1)
        return order.normal(size=(501, 3)), fan
    faces = np.array([order.choice(60, 3, replace=False) for _ in range(2000)])
    return order.normal(size=(60, 3)), faces


@pytest.mark.filterwarnings("ignore::gcnd.errors.MeshWarning")
@pytest.mark.parametrize("method", ["l0", "tgv", "bilateral-normal-implicit"])
def test_a_system_that_does_not_fit_is_not_made(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    vertices, faces = tangled(method)
    bytes_a_face = memory.filter_bytes_a_face(method, len(faces))
    foreseen = memory.needed_bytes(len(vertices), len(faces), bytes_a_face)
    for module in (filters, memory):
        monkeypatch.setattr(module, "available_bytes", lambda: foreseen)
    told: list[float] = []
    with pytest.raises(MeshError, match=r"the system to be solved takes about .* GB are free") as caught:
        apply_filter((vertices, faces), method, progress=lambda fraction, _: told.append(fraction))
    assert caught.value.hint is not None
    assert max(told) < 0.1


def test_what_is_free_is_what_the_group_leaves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "_MEMINFO", tmp_path / "meminfo")
    monkeypatch.setattr(memory, "_CGROUP", tmp_path)
    assert memory.available_bytes() is None
    (tmp_path / "meminfo").write_text("MemTotal:  9000 kB\nMemAvailable:    5000 kB\n")
    assert memory.available_bytes() == 5000 * 1024
    (tmp_path / "memory.max").write_text("max\n")
    (tmp_path / "memory.current").write_text("1000000\n")
    assert memory.available_bytes() == 5000 * 1024
    (tmp_path / "memory.max").write_text("3000000\n")
    assert memory.available_bytes() == 2_000_000
    (tmp_path / "memory.stat").write_text("anon 400000\ninactive_file 300000\nactive_file 100000\n")
    assert memory.available_bytes() == 2_300_000


def test_more_vertices_than_ids_are_refused() -> None:
    vertices = np.broadcast_to(np.zeros(3), (2**32, 3))  # takes no memory
    with pytest.raises(MeshError, match=r"4,294,967,296 vertices are too many, allowed: 4,294,967,295"):
        checked(vertices, np.array([[0, 1, 2]]))


def test_coordinates_whose_squares_are_no_numbers_are_named() -> None:
    with pytest.raises(
        MeshError, match=r"vertex 1 is at \(1\.0, 1e\+151, 0\.0\), allowed: coordinates up to 1e\+150"
    ):
        checked(np.array([[0.0, 0, 0], [1, 1e151, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))


# --- what fuzzing found ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("extension", "data", "message"),
    [
        # A negative count is an index from the end in Python: faces were read as vertices.
        (".off", b"OFF\n-4 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "announces -4 vertices and 1 faces"),
        (".off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\nx 0 1 2\n", "face 0 begins with 'x', not with 3"),
        # Half an index was cut down to a whole one.
        (".ply", "3 0 1 1.5", "'vertex_indices' of face 0 is 1.5, which is no int32"),
        (".ply", "3 0 1 nan", "'vertex_indices' of face 0 is nan, which is no int32"),
        (".ply", "3 0 1 4294967298", "'vertex_indices' of face 0 is 4.29497e[+]09, which is no int32"),
    ],
)
def test_numbers_that_were_read_as_others(tmp_path: Path, extension: str, data: Any, message: str) -> None:
    if extension == ".ply":
        head = PLY_HEAD.format(format="ascii", v=3) + PLY_TAIL.format(f=1)
        data = f"{head}0 0 0\n1 0 0\n0 1 0\n{data}\n".encode()
    (tmp_path / f"a{extension}").write_bytes(data)
    with pytest.raises(MeshError, match=message):
        load(tmp_path / f"a{extension}")


def test_many_materials_take_no_longer_than_their_number(tmp_path: Path) -> None:
    lines = "".join(f"usemtl m{number}\nf 1 2 3\n" for number in range(30_000))
    (tmp_path / "a.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\n{lines}")
    since = time.process_time()
    assert load(tmp_path / "a.obj").face_attributes["material_id"].tolist() == list(range(30_000))
    assert time.process_time() - since < 3.0  # it took 30 s


@pytest.mark.parametrize(
    ("part", "change", "message"),
    [
        ("patch", {"n_nodes": 10**9}, "n_nodes is 1000000000, allowed: a whole number, 16 to 512"),
        ("patch", {"n_nodes": "32"}, "n_nodes is '32'"),
        ("patch", {"vertex_offsets": 1}, "vertex_offsets is 1"),
        ("network", {"knn_k": 4.5}, "knn_k is 4.5"),
        ("network", {"pool_channels": 10**12}, "pool_channels is 1000000000000"),
        ("", {"passes": 10**9}, "passes is 1000000000, allowed: a whole number, 1 to 100"),
    ],
)
def test_weights_that_ask_for_too_much(
    tmp_path: Path, part: str, change: dict[str, Any], message: str
) -> None:
    tensors, header = load_tensors(tiny_weights(tmp_path))
    stage = header["cascade"]["stages"][0]
    (stage[part] if part else stage).update(change)
    save_tensors(tmp_path / "b.safetensors", tensors, header)
    with pytest.raises(WeightsError, match=message):
        load_cascade(str(tmp_path / "b.safetensors"))


def test_weights_that_are_no_numbers(tmp_path: Path) -> None:
    tensors, header = load_tensors(tiny_weights(tmp_path))
    name = next(iter(tensors))
    for change, message in (
        (tensors[name] * float("nan"), "has values that are not finite"),
        (tensors[name].int(), "has type torch.int32"),
    ):
        save_tensors(tmp_path / "b.safetensors", tensors | {name: change}, header)
        with pytest.raises(WeightsError, match=f"{name} {message}"):
            load_cascade(str(tmp_path / "b.safetensors"))

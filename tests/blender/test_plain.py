"""What the Blender add-on does without Blender: arrays, the two ways to run gcnd, presets, and the packed extension."""

from __future__ import annotations

import ast
import sys
import threading
import time
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from blender_cases import MOVES, PLUGINS, ROOT, program

import gcnd
from cli_cases import FACES, VERTICES
from gcnd.controls import Controls
from gcnd.filters import apply_filter
from gcnd_denoise import arrays, presets, runs
from gcnd_denoise.arrays import Triangles
from gcnd_denoise.errors import Failure, Stopped
from test_docs_site import script

MESH = Triangles(VERTICES.astype(np.float32), FACES.astype(np.int32))
WAITS = "import time\nfrom pathlib import Path\nPath(__file__).with_name('started').touch()\ntime.sleep(60)\n"


def noisy_ball() -> Triangles:
    ball = trimesh.creation.icosphere(subdivisions=2)
    noisy = ball.vertices + np.random.default_rng(0).normal(scale=0.05, size=ball.vertices.shape)
    return Triangles(noisy.astype(np.float32), ball.faces.astype(np.int32))


def test_blending_is_that_of_gcnd() -> None:
    ball = noisy_ball()
    # Vertex 0 twice, as texture seams have it.
    before, faces = np.vstack([ball.positions, ball.positions[:1]]), ball.faces.copy()
    seam = np.flatnonzero((faces == 0).any(axis=1))[0]
    faces[seam, faces[seam] == 0] = len(ball.positions)
    after, keep = apply_filter((before, faces), "laplacian")[0], np.arange(len(before)) < 10
    assert np.abs(after - before).max() > 0.05
    for strength in (0.0, 0.3, 1.0):
        controls = Controls(strength=strength, keep=keep)
        expected = apply_filter((before, faces), "laplacian", controls=controls)[0]
        found = arrays.blended(before, after, strength, keep)
        assert found.dtype == np.float32
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
        assert np.array_equal(found[keep], before[keep])
        assert np.array_equal(found[-1], before[0])


def test_both_ends_of_the_strength_are_exact() -> None:
    before = np.array([[-0.0, 1e-30, 1e8], [0.1, 0.2, 0.3]], dtype=np.float32)
    after = np.array([[1e8, 1.0, 1e-30], [0.1, 0.2, 0.3]], dtype=np.float32)
    assert arrays.blended(before, after, 0.0).tobytes() == before.tobytes()
    assert arrays.blended(before, after, 1.0).tobytes() == after.tobytes()
    half = arrays.blended(before, after, 0.5)
    assert half[0].tolist() == [5e7, 0.5, 5e7]
    assert half[1].tobytes() == before[1].tobytes()


def test_what_moved_in_words() -> None:
    after = MESH.positions + np.float32([[3, 4, 0], [0, 0, 0], [0, 0, 1], [0, 0, 0]])
    assert arrays.moved_text(MESH.positions, after) == "2 of 4 vertices moved, 5 at most"


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        (Triangles(np.empty((0, 3), np.float32), np.empty((0, 3), np.int32)), "empty"),
        (Triangles(MESH.positions, np.empty((0, 3), np.int32)), "no faces"),
        (
            Triangles(np.where([[0], [0], [1], [1]], np.nan, MESH.positions), MESH.faces),
            "2 vertices .* first is vertex 2",
        ),
        (Triangles(np.where([[0], [1], [0], [0]], np.inf, MESH.positions), MESH.faces), "first is vertex 1"),
    ],
)
def test_meshes_that_cannot_be_denoised(mesh: Triangles, message: str) -> None:
    with pytest.raises(Failure, match=message):
        arrays.check(mesh)
    arrays.check(MESH)


def test_gcnd_reads_the_file_and_its_result_is_read(tmp_path: Path) -> None:
    source, target = tmp_path / "in.ply", tmp_path / "out.ply"
    arrays.write_ply(source, MESH)
    mesh = gcnd.mesh_io.load(source)
    assert np.array_equal(mesh.vertices, MESH.positions)
    assert np.array_equal(mesh.faces, MESH.faces)
    gcnd.mesh_io.save((mesh.vertices + 0.25, mesh.faces), target, like=source)
    assert np.array_equal(arrays.read_positions(target, source), MESH.positions + np.float32(0.25))


@pytest.mark.parametrize(
    "change", [lambda b: b[:-1], lambda b: b.replace(b"face 4", b"face 3"), lambda b: b[:-1] + b"\7"]
)
def test_another_mesh_is_not_taken(tmp_path: Path, change: Any) -> None:
    source, target = tmp_path / "in.ply", tmp_path / "out.ply"
    arrays.write_ply(source, MESH)
    target.write_bytes(change(source.read_bytes()))
    with pytest.raises(Failure, match="another mesh"):
        arrays.read_positions(target, source)


def test_the_command_moves_the_mesh_and_its_folder_goes(tmp_path: Path) -> None:
    run = runs.CommandRun(MESH, "fast", program(tmp_path, MOVES))
    run.start()
    assert np.array_equal(run.result(), MESH.positions + np.float32(0.5))
    assert (run.fraction, run.stage) == (0.4, "normals, pass 1 of 2")
    folder = Path((tmp_path / "folder.txt").read_text())
    assert folder.name.startswith("gcnd_")
    assert not folder.exists()


def test_the_real_command_gives_what_gcnd_gives() -> None:
    ball = noisy_ball()
    run = runs.CommandRun(ball, "fast", (sys.executable, "-m", "gcnd"))
    run.start()
    expected = gcnd.denoise(tuple(ball), preset="fast")[0]
    assert np.array_equal(run.result(), expected)
    assert run.fraction > 0.0


def test_the_command_is_told_the_preset_and_its_error_is_passed_on(tmp_path: Path) -> None:
    says = "import sys\nsys.exit('a library warns\\nerror: ' + sys.argv[5] + '\\n\\nhint: try')\n"
    run = runs.CommandRun(MESH, "quick", program(tmp_path, says))
    run.start()
    with pytest.raises(Failure, match=r"^quick$") as caught:
        run.result()
    assert caught.value.text() == "quick\nHint: try"


@pytest.mark.parametrize(
    ("text", "message"),
    [("raise SystemExit(3)", "ended with code 3$"), ("print(1)", "code 0$"), ("1 / 0", "ZeroDivisionError")],
)
def test_a_command_that_is_not_gcnd(tmp_path: Path, text: str, message: str) -> None:
    run = runs.CommandRun(MESH, "fast", program(tmp_path, text))
    run.start()
    with pytest.raises(Failure, match=message):
        run.result()


def test_stopping_ends_the_command_and_its_folder_goes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    run = runs.CommandRun(MESH, "fast", program(tmp_path, WAITS))
    run.start()
    while not (tmp_path / "started").exists():
        time.sleep(0.01)
    assert len(list((tmp_path / "temporary").iterdir())) == 1
    start = time.monotonic()
    run.stop()
    with pytest.raises(Stopped):
        run.result()
    assert time.monotonic() - start < 10
    assert list((tmp_path / "temporary").iterdir()) == []


def test_a_run_stopped_before_it_starts_starts_no_command(tmp_path: Path) -> None:
    run = runs.CommandRun(MESH, "fast", program(tmp_path, WAITS))
    run.stop()
    run.start()
    with pytest.raises(Stopped):
        run.result()
    assert not (tmp_path / "started").exists()


def test_a_program_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(Failure, match="no program 'no-such-gcnd'") as caught:
        runs.find_command("no-such-gcnd")
    assert "preferences" in caught.value.text()
    with pytest.raises(Failure, match="no program ''"):
        runs.find_command("")
    run = runs.CommandRun(MESH, "fast", (str(tmp_path / "gone"),))
    run.start()
    with pytest.raises(Failure, match="cannot be started: No such file"):
        run.result()
    assert runs.find_command(sys.executable) == (sys.executable,)


def replace_denoise(monkeypatch: pytest.MonkeyPatch, denoise: Any) -> None:
    names = {name: getattr(gcnd, name) for name in ("Cancelled", "GcndError")}
    monkeypatch.setitem(sys.modules, "gcnd", SimpleNamespace(denoise=denoise, **names))


def test_in_python_the_work_is_done_in_a_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def denoise(mesh: Any, *, preset: str, progress: Any) -> Any:
        assert progress(0.25, "normals") is True
        asked.append((type(mesh), preset, threading.current_thread() is threading.main_thread()))
        return mesh[0] + 1.0, mesh[1]

    replace_denoise(monkeypatch, denoise)
    run = runs.PythonRun(MESH, "fast")
    run.start()
    assert np.array_equal(run.result(), MESH.positions + np.float32(1.0))
    assert run.is_done()
    assert (run.fraction, run.stage) == (0.25, "normals")
    assert asked == [(tuple, "fast", False)]


def test_in_python_stopping_is_answered_to_gcnd(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = threading.Event()

    def denoise(mesh: Any, *, preset: str, progress: Any) -> Any:
        while progress(0.5, "normals"):
            asked.set()
        raise gcnd.Cancelled("cancelled at 50 %")

    replace_denoise(monkeypatch, denoise)
    run = runs.PythonRun(MESH, "fast")
    run.start()
    assert asked.wait(10)
    assert not run.is_done()
    run.stop()
    with pytest.raises(Stopped):
        run.result()


@pytest.mark.parametrize(
    ("raised", "error", "message"),
    [
        (gcnd.ConfigError("no preset", hint="try fast"), Failure, "no preset"),
        (ZeroDivisionError("a bug"), ZeroDivisionError, "a bug"),
    ],
)
def test_errors_in_the_thread_reach_who_asks(
    monkeypatch: pytest.MonkeyPatch, raised: Exception, error: type[Exception], message: str
) -> None:
    def denoise(mesh: Any, *, preset: str, progress: Any) -> Any:
        raise raised

    replace_denoise(monkeypatch, denoise)
    run = runs.PythonRun(MESH, "fast")
    run.start()
    with pytest.raises(error, match=message) as caught:
        run.result()
    assert getattr(caught.value, "hint", None) == getattr(raised, "hint", None)


def test_results_that_do_not_fit_are_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    for result in (MESH.positions[:3], MESH.positions * np.float32(np.nan)):
        replace_denoise(monkeypatch, lambda mesh, result=result, **options: (result, mesh[1]))
        run = runs.PythonRun(MESH, "fast")
        run.start()
        with pytest.raises(Failure, match="do not fit"):
            run.result()


def test_gcnd_that_cannot_be_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gcnd", None)
    run = runs.PythonRun(MESH, "fast")
    run.start()
    with pytest.raises(Failure, match="gcnd cannot be imported") as caught:
        run.result()
    assert "preferences" in caught.value.text()


def test_presets_of_the_command_and_of_python_are_the_same() -> None:
    found = presets.from_command((sys.executable, "-m", "gcnd"))
    assert found == presets.from_python()
    assert [name for name, _ in found][:3] == [name for name, _ in presets.KNOWN]
    assert presets.parsed(presets.stored(found)) == found


@pytest.mark.parametrize("text", ["", "{}", "[]", "[1]", '[{"name": "a"}]', "null"])
def test_what_is_no_list_of_presets(text: str) -> None:
    with pytest.raises(Failure, match="presets"):
        presets.parsed(text)


def test_a_program_that_lists_no_presets(tmp_path: Path) -> None:
    with pytest.raises(Failure, match="does not list presets"):
        presets.from_command(program(tmp_path, "print('hello')"))
    with pytest.raises(Failure, match="ended with code 2"):
        presets.from_command(program(tmp_path, "raise SystemExit(2)"))
    with pytest.raises(Failure, match="cannot be started"):
        presets.from_command((str(tmp_path / "gone"),))


def test_the_extension_is_packed_the_same_each_time(tmp_path: Path) -> None:
    extension = script("blender_extension")
    path = extension.pack(tmp_path / "a")
    assert path.name == "gcnd_denoise-0.1.0.zip"
    assert path.read_bytes() == extension.pack(tmp_path / "b").read_bytes()
    with zipfile.ZipFile(path) as packed:
        modules = {p.name for p in (PLUGINS / "gcnd_denoise").glob("*.py")}
        assert set(packed.namelist()) == modules | {"blender_manifest.toml", "LICENSE-MIT"}
        assert packed.read("LICENSE-MIT") == (ROOT / "LICENSE-MIT").read_bytes()


def test_the_extension_has_the_version_of_gcnd() -> None:
    cargo = (ROOT / "Cargo.toml").read_text(encoding="utf-8")
    assert f'\nversion = "{script("blender_extension").version()}"\n' in cargo


@pytest.mark.parametrize("name", ["__init__", "arrays", "errors", "presets", "runs"])
def test_these_modules_need_no_blender(name: str) -> None:
    tree = ast.parse((PLUGINS / "gcnd_denoise" / f"{name}.py").read_text(encoding="utf-8"))
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    assert "bpy" not in imported

"""The command line: what it calls, what it prints where, and how errors are told."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli_cases import FACES, VERTICES, FakeDenoiser, stand_in
from gcnd.cli import main
from gcnd.controls import Controls
from gcnd.errors import ConfigError, GcndError
from gcnd.mesh_io import load, save


def run_program(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "gcnd.cli", *arguments], capture_output=True, text=True, timeout=120, **options
    )


# --- denoise -----------------------------------------------------------------------------------------


def test_denoise_passes_every_option_on(
    mesh_path: Path, denoise_calls: list[dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    out = mesh_path.with_name("out.obj")
    options = ["--preset", "paper", "--device", "cuda", "--seed", "7"]
    options += ["--normal-iterations", "4", "--vertex-iterations", "3", "--strength", "0.5"]
    options += ["--max-displacement", "0.2", "--max-displacement-edges", "3", "--keep", "region"]
    options += ["--preserve-volume"]
    assert main(["denoise", str(mesh_path), str(out), *options]) == 0
    (call,) = denoise_calls
    assert np.array_equal(call.pop("mesh").vertices, VERTICES)
    assert call == {
        "preset": "paper",
        "device": "cuda",
        "seed": 7,
        "normal_iterations": 4,
        "vertex_iterations": 3,
        "strength": 0.5,
        "max_displacement": 0.2,
        "max_displacement_edges": 3.0,
        "keep": "region",
        "preserve_volume": True,
    }
    assert np.array_equal(load(out).vertices, VERTICES + 1.0)
    printed = capsys.readouterr()
    assert printed.out == ""
    stages = printed.err.splitlines()
    assert stages[:2] == ["normals, pass 1 of 2 (0% done)", "[bold] 2 (50% done)"]
    assert stages[2].startswith(f"wrote {out}: 4 faces in ")


def test_denoise_defaults(mesh_path: Path, denoise_calls: list[dict[str, Any]]) -> None:
    assert main(["denoise", str(mesh_path), str(mesh_path.with_name("out.ply"))]) == 0
    (call,) = denoise_calls
    assert (call["preset"], call["device"], call["seed"]) == ("auto", "cpu", 0)
    assert (call["normal_iterations"], call["vertex_iterations"]) == (None, None)
    assert {name: call[name] for name in Controls().described()} == Controls().described()


def test_quiet_prints_nothing(
    mesh_path: Path, denoise_calls: list[dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["denoise", str(mesh_path), str(mesh_path.with_name("out.ply")), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert len(denoise_calls) == 1


def test_denoise_json_is_all_of_stdout(
    mesh_path: Path, denoise_calls: list[dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    out = mesh_path.with_name("out.ply")
    assert main(["denoise", str(mesh_path), str(out), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report.pop("seconds") >= 0.0
    assert report == {
        "input": str(mesh_path),
        "output": str(out),
        "vertices": 4,
        "faces": 4,
        "preset": "default",
        "device": "cpu",
        "seed": 0,
    }
    assert len(denoise_calls) == 1


def test_bad_output_is_told_before_any_work(
    mesh_path: Path, denoise_calls: list[dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    before = mesh_path.read_bytes()
    for out, message in [
        (str(mesh_path), "is the input itself"),
        (str(mesh_path.with_suffix(".fbx")), "unknown mesh format '.fbx'"),
        (str(mesh_path.parent / "no" / "out.ply"), "does not exist"),
    ]:
        assert main(["denoise", str(mesh_path), out]) == 1
        printed = capsys.readouterr()
        assert printed.out == ""
        error, blank, hint = printed.err.splitlines()
        assert error.startswith("error: ")
        assert message in error
        assert blank == ""
        assert hint.startswith("hint: ")
    assert denoise_calls == []
    assert mesh_path.read_bytes() == before


@pytest.mark.parametrize("command", [["denoise"], ["noise", "--level", "0.1"]])
def test_a_format_that_is_not_read_is_the_inputs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: list[str]
) -> None:
    source = tmp_path / "in.gltf"
    source.write_text("{}")
    for out in ("out.gltf", "out.ply"):
        assert main([command[0], str(source), str(tmp_path / out), *command[1:]]) == 1
        error, _, hint = capsys.readouterr().err.splitlines()
        assert error == f"error: {source}: unknown mesh format '.gltf'"
        assert hint.endswith("export it again as .glb, which is glTF in one file")


def test_terminal_gets_a_bar(
    mesh_path: Path,
    denoise_calls: list[dict[str, Any]],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    assert main(["denoise", str(mesh_path), str(mesh_path.with_name("out.ply"))]) == 0
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "[bold] 2" in printed.err
    assert "50%" in printed.err
    assert "(50% done)" not in printed.err
    assert len(denoise_calls) == 1


# --- errors ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("raised", "code", "told"),
    [
        (
            ConfigError("no preset 'x'", hint="see gcnd models"),
            1,
            "error: no preset 'x'\n\nhint: see gcnd models\n",
        ),
        (GcndError("odd"), 1, "error: odd\n"),
        (
            OSError(errno.ENOSPC, "No space left on device", "/data/a"),
            1,
            "error: /data/a: No space left on device\n\n"
            "hint: free some space, or write elsewhere; what stood there is as it was\n",
        ),
        (OSError("bare"), 1, "error: bare\n"),
        (KeyboardInterrupt(), 130, ""),
    ],
)
def test_errors_are_told_without_a_traceback(
    mesh_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    raised: BaseException,
    code: int,
    told: str,
) -> None:
    stand_in(monkeypatch, "gcnd.denoiser", Denoiser=type("Fake", (FakeDenoiser,), {"raised": raised}))
    out = mesh_path.with_name("out.ply")
    assert main(["denoise", str(mesh_path), str(out), "--quiet"]) == code
    assert capsys.readouterr() == ("", told)
    assert not out.exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["denoise"],
        ["denoise", "a.ply", "b.ply", "--device", "tpu"],
        ["denoise", "a.ply", "b.ply", "--vertex-iterations", "-1"],
        ["denoise", "a.ply", "b.ply", "--strength", "1.1"],
        ["denoise", "a.ply", "b.ply", "--max-displacement", "-1"],
        ["noise", "a.ply", "b.ply"],
        ["noise", "a.ply", "b.ply", "--level", "-0.1"],
        ["noise", "a.ply", "b.ply", "--level", "0.1", "--fraction", "1.5"],
        ["evaluate", "a.ply", "b.ply", "--samples", "0"],
        ["train", "--threads", "0"],
        ["frobnicate"],
        ["--frobnicate"],
    ],
)
def test_wrong_command_lines_exit_with_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "Usage: gcnd" in printed.err


def test_no_arguments_show_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    shown = capsys.readouterr().out
    assert all(name in shown for name in ("denoise", "noise", "evaluate", "info", "models", "--version"))


def test_brackets_in_the_help_are_no_markup(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    assert main(["denoise", "--help"]) == 0
    assert "gcnd[ray]" in capsys.readouterr().out


# --- noise, evaluate, info, models -------------------------------------------------------------------


def test_noise_passes_its_options_on(mesh_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[dict[str, Any]] = []

    def add_noise(vertices: np.ndarray, faces: np.ndarray, **options: Any) -> np.ndarray:
        assert np.array_equal(faces, FACES)
        calls.append(options)
        return vertices + 0.5

    stand_in(monkeypatch, "gcnd.data.noise", add_noise=add_noise)
    out = mesh_path.with_name("noisy.ply")
    base = ["noise", str(mesh_path), str(out), "--level"]
    assert main([*base, "0.2"]) == 0
    assert main([*base, "0.4", "--kind", "impulsive", "--fraction", "0.1", "--seed", "3"]) == 0
    assert calls == [
        {"kind": "gaussian", "level": 0.2, "fraction": 0.3, "seed": 0},
        {"kind": "impulsive", "level": 0.4, "fraction": 0.1, "seed": 3},
    ]
    assert np.array_equal(load(out).vertices, VERTICES + 0.5)


@pytest.mark.parametrize(("preset", "wanted"), [("scan", "scanned_corpus"), ("fast", "generated_corpus")])
def test_train_takes_the_data_of_its_recipe(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    preset: str,
    wanted: str,
) -> None:
    from gcnd.train import corpus

    def stop(name: str) -> Any:
        def called(*arguments: Any) -> None:
            raise GcndError(f"{name} {[str(a) for a in arguments[1:4]]}")

        return called

    for name in ("scanned_corpus", "generated_corpus", "paired_corpus"):
        monkeypatch.setattr(corpus, name, stop(name))
    out = tmp_path / "run"
    places = [str(out / "shapes"), "None"] + ([str(out / "scans")] if preset == "scan" else [])
    assert main(["train", "--preset", preset, "--out", str(out)]) == 1
    assert capsys.readouterr().err.strip() == f"error: {wanted} {places}"


def test_evaluate_prints_both_errors(
    mesh_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    calls: list[tuple[Any, ...]] = []

    def normal_error(result: np.ndarray, truth: np.ndarray, faces: np.ndarray) -> float:
        assert np.array_equal(truth, VERTICES)
        assert np.array_equal(result, VERTICES + 1.0)
        assert np.array_equal(faces, FACES)
        return 1.5

    def vertex_error(*arguments: Any) -> float:
        calls.append(arguments)
        return 0.00025

    stand_in(monkeypatch, "gcnd.metrics", normal_error=normal_error, vertex_error=vertex_error)
    result = mesh_path.with_name("result.ply")
    save((VERTICES + 1.0, FACES), result)
    assert main(["evaluate", str(result), str(mesh_path)]) == 0
    assert capsys.readouterr().out == "E_a  1.5000 degrees\nE_v  0.2500 (times 1000)\n"
    assert main(["evaluate", str(result), str(mesh_path), "--json", "--samples", "10", "--seed", "2"]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "normal_error_degrees": 1.5,
        "vertex_error_times_1000": 0.25,
        "faces": 4,
        "samples": 10,
        "seed": 2,
    }
    assert [call[4:] for call in calls] == [(200_000, 0), (10, 2)]
    assert np.array_equal(calls[0][0], VERTICES + 1.0)
    assert np.array_equal(calls[0][2], VERTICES)


def test_error_that_is_not_defined_is_null_in_json(
    mesh_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stand_in(monkeypatch, "gcnd.metrics", normal_error=lambda *_: float("nan"), vertex_error=lambda *_: 0.001)
    assert main(["evaluate", str(mesh_path), str(mesh_path), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["normal_error_degrees"] is None
    assert report["vertex_error_times_1000"] == 1.0


def test_evaluate_needs_the_same_faces(mesh_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = mesh_path.with_name("other.ply")
    save((VERTICES, FACES[:3]), other)
    assert main(["evaluate", str(other), str(mesh_path)]) == 1
    assert "RESULT has 3 faces and TRUTH has 4" in capsys.readouterr().err
    save((VERTICES, FACES[[0, 1, 3, 2]]), other)
    assert main(["evaluate", str(other), str(mesh_path)]) == 1
    assert "face 2 is (1, 2, 3) in RESULT and (0, 3, 2) in TRUTH" in capsys.readouterr().err


def test_info(mesh_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(mesh_path), "--json"]) == 0
    info = json.loads(capsys.readouterr().out)
    assert info["faces"] == 4
    assert info["watertight"] is True
    assert main(["info", str(mesh_path)]) == 0
    rows = dict(line.rsplit(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert rows["boundary edges"] == "0"
    assert rows["bounding box diagonal"] == "1.73205"
    assert rows["watertight"] == "yes"
    assert len(rows) == len(info)


def test_models(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    fields = {
        "name": "small",
        "description": "For tests.",
        "n_parameters": 1234567,
        "file_bytes": 2_500_000,
        "licence": "MIT",
        "sha256": "ab" * 32,
        "auto": True,
    }
    card = {
        "data": {"shapes": 12, "meshes": [{"names": "a, b"}, {"names": "c"}]},
        "measured": {
            "speed": {"faces_per_second": 12345, "hardware": "two cores"},
            "e_a_degrees": {"generated cad": {"0.1": 1.25, "0.3": 2.5}, "real": {"0.1": 3.0, "0.3": 14.0}},
        },
    }
    models = [types.SimpleNamespace(**fields, card=card), types.SimpleNamespace(**fields, card={})]
    stand_in(monkeypatch, "gcnd.weights", list_models=lambda: models)
    assert main(["models", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == [fields | card, fields]
    assert main(["models"]) == 0
    head = "small (auto): 1,234,567 weights, 2.5 MB, MIT\n    For tests.\n"
    assert capsys.readouterr().out == (
        head + "    12,345 faces/s on two cores\n"
        "    trained on 12 generated shapes and 3 openly licensed meshes\n"
        "    E_a in degrees, noise     0.1     0.3\n"
        "    generated cad            1.25    2.50\n"
        "    real                     3.00   14.00\n"
        "\n" + head
    )


# --- the program -------------------------------------------------------------------------------------


def test_program_tells_a_missing_file(tmp_path: Path) -> None:
    done = run_program("info", str(tmp_path / "missing.ply"))
    assert done.returncode == 1
    assert done.stdout == ""
    error, _, hint = done.stderr.splitlines()
    assert error == f"error: no such file: {tmp_path / 'missing.ply'}"
    assert hint.startswith("hint: ")


def test_version() -> None:
    done = run_program("--version")
    assert done.returncode == 0
    assert done.stdout.startswith("gcnd ")


def test_commands_import_nothing_heavy_until_they_run() -> None:
    code = (
        "import sys; import gcnd; before = set(sys.modules); import gcnd.cli; "
        "print({'torch', 'trimesh', 'scipy', 'numpy', 'gcnd.mesh_io'} & (set(sys.modules) - before))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.stdout == "set()\n"


@pytest.mark.skipif(os.name == "nt", reason="no such pipes")
@pytest.mark.parametrize("is_unbuffered", [False, True])
def test_reader_that_went_away_is_no_error(mesh_path: Path, is_unbuffered: bool) -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    environment = {**os.environ, "PYTHONUNBUFFERED": "1" if is_unbuffered else ""}
    done = subprocess.run(
        [sys.executable, "-m", "gcnd.cli", "info", str(mesh_path)],
        stdout=write_end,
        stderr=subprocess.PIPE,
        text=True,
        timeout=120,
        env=environment,
    )
    os.close(write_end)
    assert done.stderr == ""
    assert done.returncode == 1

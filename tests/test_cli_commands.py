"""Commands of one mesh or none: what they call, and what they print where."""

from __future__ import annotations

import json
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli_cases import FACES, VERTICES, stand_in
from gcnd.cli import main
from gcnd.errors import GcndError
from gcnd.mesh_io import load, save


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
        {"kind": "gaussian", "level": 0.2, "seed": 0},
        {"kind": "impulsive", "level": 0.4, "fraction": 0.1, "seed": 3},
    ]
    assert np.array_equal(load(out).vertices, VERTICES + 0.5)


@pytest.mark.parametrize("kind", ["gaussian", "isotropic", "kinect1"])
def test_a_fraction_that_does_not_apply_is_refused(
    mesh_path: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    out = mesh_path.with_name("noisy.ply")
    assert main(["noise", str(mesh_path), str(out), "--kind", kind, "--fraction", "0.1"]) == 1
    assert f"error: --fraction does not apply to {kind}" in capsys.readouterr().err
    assert not out.exists()


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
        def called(*arguments: Any, on_event: Any) -> None:
            raise GcndError(f"{name} {[str(a) for a in arguments[1:4]]}")

        return called

    for name in ("scanned_corpus", "generated_corpus", "paired_corpus"):
        monkeypatch.setattr(corpus, name, stop(name))
    out = tmp_path / "run"
    places = [str(out / "shapes"), "None"] + ([str(out / "scans")] if preset == "scan" else [])
    assert main(["train", "--preset", preset, "--out", str(out)]) == 1
    assert capsys.readouterr().err.strip() == f"error: {wanted} {places}"


def test_train_does_not_replace_the_weights_that_it_starts_from(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    weights = tmp_path / "fast.safetensors"
    weights.write_bytes(b"weights")
    assert main(["train", "--preset", "fast", "--out", str(tmp_path), "--start-from", str(weights)]) == 1
    assert "fast.safetensors is the input itself" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["fast.safetensors"]


def test_ctrl_c_says_that_training_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from gcnd.train import corpus, run

    class Stopped:
        def __init__(self, *_: Any, **__: Any) -> None:
            pass

        def run(self) -> Path:
            raise KeyboardInterrupt

    monkeypatch.setattr(run, "TrainingRun", Stopped)
    monkeypatch.setattr(corpus, "generated_corpus", lambda *_, **__: None)
    assert main(["train", "--out", str(tmp_path)]) == 130
    assert "the same command goes on from the last checkpoint" in capsys.readouterr().err


def test_train_leaves_nothing_where_its_data_is_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    for option, told in (("--pairs", "is not a folder of pairs"), ("--meshes", "is not a folder of meshes")):
        assert main(["train", "--out", str(out), option, str(tmp_path / "nowhere")]) == 1
        assert told in capsys.readouterr().err
    assert main(["train", "--out", str(out), "--scale", "inf"]) == 1
    assert "scale is inf, allowed: above 0" in capsys.readouterr().err
    assert not out.exists()


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

"""`gcnd denoise`: confidence and report of one mesh; folders are in test_many.py."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli_cases import VERTICES
from gcnd.cli import main
from gcnd.mesh_io import load


def test_confidence_becomes_a_face_attribute(mesh_path: Path, denoise_calls: list[dict[str, Any]]) -> None:
    out = mesh_path.with_name("out.ply")
    assert main(["denoise", str(mesh_path), str(out), "-q", "--confidence"]) == 0
    assert denoise_calls[0]["confidence"] is True
    written = load(out)
    assert written.face_attributes["confidence"].dtype == np.float32
    assert np.array_equal(written.face_attributes["confidence"], np.linspace(0, 1, 4, dtype=np.float32))
    assert np.array_equal(written.vertices, VERTICES + 1.0)
    assert main(["denoise", str(mesh_path), str(out), "-q"]) == 0
    assert "confidence" not in load(out).face_attributes


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("out.stl", [], "only .ply holds a confidence by face"),
        ("out.ply", ["--method", "taubin"], "--confidence is for presets"),
    ],
)
def test_confidence_without_a_place_or_a_network(
    mesh_path: Path,
    denoise_calls: list[dict[str, Any]],
    capsys: pytest.CaptureFixture[str],
    name: str,
    options: list[str],
    message: str,
) -> None:
    out = mesh_path.with_name(name)
    assert main(["denoise", str(mesh_path), str(out), "--confidence", *options]) == 1
    assert message in capsys.readouterr().err
    assert denoise_calls == []
    assert not out.exists()


def test_the_report_of_a_preset(mesh_path: Path, denoise_calls: list[dict[str, Any]]) -> None:
    report = mesh_path.with_name("report.json")
    assert (
        main(["denoise", str(mesh_path), str(mesh_path.with_name("out.ply")), "-q", "--report", str(report)])
        == 0
    )
    found = json.loads(report.read_text())
    assert found["displacement"]["mean"] == pytest.approx(3**0.5)
    assert found["seconds"]["normals"] == 0.25
    assert found["seconds"]["writing"] > 0
    assert found["seconds"]["loading"] > 0
    assert found["method"] == {"preset": "default"}
    assert len(denoise_calls) == 1


@pytest.mark.parametrize("options", [[], ["--overwrite"]])
def test_a_single_result_is_always_written_anew(
    mesh_path: Path, denoise_calls: list[dict[str, Any]], options: list[str]
) -> None:
    """A folder's results are skipped where they are there; of one mesh, `--overwrite` says what is done anyway."""
    out = mesh_path.with_name("out.ply")
    out.write_text("an older result, newer than its input")
    assert main(["denoise", str(mesh_path), str(out), "-q", *options]) == 0
    assert np.array_equal(load(out).vertices, VERTICES + 1.0)
    assert len(denoise_calls) == 1

"""`gcnd noise --kind` of a scan: pairs on disk, and what is told when options do not fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scan_cases import ball

from gcnd.cli import main
from gcnd.data.pairs import PairFiles, load_pair
from gcnd.mesh_io import load, save
from gcnd.scans import simulate


@pytest.fixture
def clean_path(tmp_path: Path) -> Path:
    path = tmp_path / "clean.ply"
    save(ball(3), path)
    return path


@pytest.mark.parametrize("kind", ["kinect1", "kinect2", "fusion"])
def test_a_pair_is_written(clean_path: Path, tmp_path: Path, kind: str) -> None:
    noisy, truth = tmp_path / "noisy.ply", tmp_path / "truth.ply"
    arguments = ["noise", str(clean_path), str(noisy), "--kind", kind, "--truth", str(truth), "--seed", "3"]
    assert main([*arguments, "--size", "0.3", "--distance", "0.9"]) == 0
    wanted = simulate(kind, *ball(3), seed=3, size=0.3, distance=0.9)  # type: ignore[arg-type]
    vertices, clean, faces = load_pair(PairFiles(noisy, truth))
    assert np.array_equal(faces, wanted.faces)
    np.testing.assert_allclose(vertices, wanted.noisy_vertices, atol=1e-6)
    np.testing.assert_allclose(clean, wanted.clean_vertices, atol=1e-6)
    assert main(["evaluate", str(noisy), str(truth)]) == 0


def test_a_print_keeps_the_faces_and_needs_no_truth(clean_path: Path, tmp_path: Path) -> None:
    out, truth = tmp_path / "print.obj", tmp_path / "truth.obj"
    assert main(["noise", str(clean_path), str(out), "--kind", "print"]) == 0
    assert np.array_equal(load(out).faces, ball(3)[1])
    wanted = simulate("print", *ball(3)).noisy_vertices
    np.testing.assert_allclose(load(out).vertices, wanted, atol=1e-6)
    assert main(["noise", str(clean_path), str(out), "--kind", "print", "--truth", str(truth)]) == 0
    np.testing.assert_allclose(load(truth).vertices, ball(3)[0], atol=1e-6)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--kind", "kinect1"], "without its truth nothing can be compared"),
        (["--kind", "fusion", "--truth", "OUT"], "--truth and OUT are both"),
        (["--kind", "kinect2", "--truth", "IN"], "clean.ply"),
        (["--kind", "kinect1", "--truth", "TRUTH", "--level", "0.1"], "--level does not apply to kinect1"),
        (["--kind", "kinect1", "--truth", "TRUTH", "--distance", "0.3"], "distance is 0.3, allowed: 0.6"),
        (["--kind", "print", "--size", "0.3"], "--size does not apply to print"),
        (["--kind", "gaussian", "--level", "0.1", "--truth", "TRUTH"], "--truth does not apply to gaussian"),
        (["--level", "0.1", "--distance", "1"], "--distance does not apply to gaussian"),
    ],
)
def test_options_that_do_not_fit_are_told(
    clean_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], told: str
) -> None:
    places = {"OUT": tmp_path / "out.ply", "TRUTH": tmp_path / "truth.ply", "IN": clean_path}
    filled = [str(places.get(option, option)) for option in options]
    before = clean_path.read_bytes()
    assert main(["noise", str(clean_path), str(places["OUT"]), *filled]) == 1
    error = capsys.readouterr().err
    assert told in error
    assert "hint: " in error
    assert "Traceback" not in error
    assert not places["OUT"].exists()
    assert not places["TRUTH"].exists()
    assert clean_path.read_bytes() == before


def test_vertex_noise_still_needs_a_level(clean_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["noise", str(clean_path), str(clean_path.with_name("out.ply"))]) == 2
    assert "--level" in capsys.readouterr().err

"""`gcnd noise --kind` of a scan: pairs on disk, and what is told when options do not fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scan_cases import ball, some_of, turned

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


@pytest.mark.parametrize("noise", [["--level", "0.3"], ["--kind", "print"]])
@pytest.mark.parametrize("is_apart", [False, True])
def test_turned_faces_give_the_same_noise_and_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], noise: list[str], is_apart: bool
) -> None:
    vertices, faces = ball(3)
    is_turned = some_of(faces)
    if is_apart:  # as STL has them
        vertices, faces = vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)
    clean, odd, outs = tmp_path / "clean.ply", tmp_path / "odd.ply", (tmp_path / "a.ply", tmp_path / "b.ply")
    save((vertices, faces), clean)
    save((vertices, turned(faces, is_turned)), odd)
    assert main(["noise", str(clean), str(outs[0]), *noise]) == 0
    assert capsys.readouterr().err == ""
    assert main(["noise", str(odd), str(outs[1]), *noise]) == 0
    told = capsys.readouterr().err
    assert told.startswith(f"warning: {is_turned.sum()} of 1,280 faces are turned against the rest")
    assert "the result has the faces of the input" in told
    assert np.array_equal(load(outs[0]).vertices, load(outs[1]).vertices)
    assert np.array_equal(load(outs[1]).faces, turned(faces, is_turned))


def test_a_volume_too_large_says_what_the_command_can_change(
    clean_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["noise", str(clean_path), str(tmp_path / "out.ply"), "--truth", str(tmp_path / "truth.ply")]
    assert main([*command, "--kind", "fusion", "--size", "9", "--distance", "6"]) == 1
    error = capsys.readouterr().err
    assert "voxel is 0.004: the volume would have" in error
    assert "hint: take a smaller size, or in Python a larger `Fusion.voxel`" in error


def test_a_camera_takes_quads_as_they_are_and_vertices_of_quads_need_leave(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    quads = tmp_path / "quad.obj"
    quads.write_text("v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3 4\n")
    command = ["noise", str(quads), str(tmp_path / "out.obj")]
    for options in (["--level", "0.1"], ["--kind", "print"]):
        assert main([*command, *options]) == 1
        assert "--triangulate" in capsys.readouterr().err
    assert main([*command, "--kind", "kinect2", "--truth", str(tmp_path / "truth.obj")]) == 0
    assert len(load(tmp_path / "truth.obj").faces) > 2000


def test_vertex_noise_still_needs_a_level(clean_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["noise", str(clean_path), str(clean_path.with_name("out.ply"))]) == 2
    assert "--level" in capsys.readouterr().err

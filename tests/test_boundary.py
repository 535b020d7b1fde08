"""How vertices on a boundary move: the outline of open meshes, by the API and the program."""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import trimesh

import gcnd
from gcnd.cli import main
from gcnd.data.noise import add_noise
from gcnd.denoise import Boundary
from gcnd.errors import ConfigError
from gcnd.filters import apply_filter
from gcnd.mesh_io import load, save
from sheet_cases import angles, cleaned, rim_loops

BALL = trimesh.creation.icosphere(subdivisions=4)


def cap() -> tuple[np.ndarray, np.ndarray]:
    """A part of a ball with a ragged rim, its vertices without those that nothing uses."""
    is_kept = BALL.triangles_center[:, 2] > 0.2 + 0.03 * np.random.default_rng(0).normal(size=len(BALL.faces))
    part = BALL.submesh([np.flatnonzero(is_kept)], append=True)
    return np.array(part.vertices), np.array(part.faces, dtype=np.uint32)


TRUTH, FACES = cap()
NOISY = add_noise(TRUTH, FACES, level=0.2, seed=1)
RIM = np.array(sorted(set(chain.from_iterable(rim_loops(FACES)))))
EDGE = float(np.mean(BALL.edges_unique_length))


@pytest.fixture(scope="module")
def results() -> dict[str, np.ndarray]:
    return {policy: cleaned(NOISY, FACES, policy) for policy in get_args(Boundary)}


def test_fixed_keeps_the_rim_to_the_bit_and_cleans_the_rest(results: dict[str, np.ndarray]) -> None:
    assert np.array_equal(results["fixed"][RIM], NOISY[RIM])
    inside = np.setdiff1d(np.arange(len(TRUTH)), RIM)
    assert (results["fixed"] != NOISY)[inside].any(axis=1).all()
    is_inner = ~np.isin(FACES, RIM).any(axis=1)
    found = angles(results["fixed"], TRUTH, FACES)
    assert found[is_inner].mean() < 0.15 * angles(NOISY, TRUTH, FACES)[is_inner].mean()


def test_along_keeps_the_outline_and_takes_the_noise_off_the_rim(results: dict[str, np.ndarray]) -> None:
    """Within the surface, which is across the ball's radius, the rim stays where it was."""
    outward = TRUTH[RIM] / np.linalg.norm(TRUTH[RIM], axis=1, keepdims=True)
    way = (results["along"] - NOISY)[RIM]
    heights = (way * outward).sum(axis=1)
    within = np.linalg.norm(way - heights[:, None] * outward, axis=1)
    assert np.sqrt((heights**2).mean()) > 0.1 * EDGE
    assert np.sqrt((within**2).mean()) < 0.05 * EDGE
    at_rim = np.isin(FACES, RIM).any(axis=1)
    noise, *found = (
        angles(v, TRUTH, FACES)[at_rim].mean() for v in (NOISY, *map(results.get, ("along", "free", "fixed")))
    )
    along, free, fixed = found
    assert along < 0.4 * noise
    assert along < free + 0.2
    assert along < 0.5 * fixed


def test_a_closed_mesh_is_the_same_bit_for_bit() -> None:
    faces = BALL.faces.astype(np.uint32)
    noisy = add_noise(np.array(BALL.vertices), faces, level=0.2, seed=2)
    free, along, fixed = (cleaned(noisy, faces, policy) for policy in get_args(Boundary))
    assert free.tobytes() == along.tobytes() == fixed.tobytes()


def test_along_is_the_default_everywhere(results: dict[str, np.ndarray]) -> None:
    assert not np.array_equal(results["along"], results["free"])
    assert np.array_equal(gcnd.denoise((NOISY, FACES), preset="fast")[0], results["along"])
    assert gcnd.Denoiser("fast").settings["boundary"] == "along"
    done = gcnd.Denoiser("fast", boundary="fixed").run((NOISY, FACES))
    assert np.array_equal(done.mesh[0], results["fixed"])
    assert done.report()["method"]["boundary"] == "fixed"


def test_another_word_is_refused() -> None:
    with pytest.raises(ConfigError, match="boundary is 'open', allowed: free, along, fixed"):
        gcnd.Denoiser("fast", boundary="open")  # type: ignore[arg-type]


def test_the_program_passes_it_on(mesh_path: Path, denoise_calls: list[dict[str, Any]]) -> None:
    program = ["denoise", str(mesh_path), str(mesh_path.with_name("out.ply")), "--quiet"]
    assert main([*program, "--boundary", "fixed"]) == 0
    assert main(program) == 0
    assert [call.get("boundary") for call in denoise_calls] == ["fixed", None]


def test_the_program_tells_filters_in_their_own_word(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "in.ply", tmp_path / "out.ply"
    save((NOISY, FACES), path)
    program = ["denoise", str(path), str(out), "--quiet", "--method", "guided-normal"]
    for policy, is_fixed in (("free", False), ("fixed", True)):
        assert main([*program, "--boundary", policy]) == 0
        expected = apply_filter(path, "guided-normal", fix_boundary=is_fixed).vertices
        assert np.allclose(load(out).vertices, expected, atol=1e-6)
        assert np.array_equal(load(out).vertices[RIM], load(path).vertices[RIM]) is is_fixed
    assert main([*program, "--boundary", "along"]) == 1
    assert "--boundary along is for presets" in capsys.readouterr().err
    assert main([*program[:-1], "l0", "--boundary", "free"]) == 1
    assert "l0 has no parameter 'fix_boundary'" in capsys.readouterr().err

"""Faces that a mesh has more than once: left out for the work, told, and given what the first of them gets."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from gcnd import Controls, Denoiser, repeats
from gcnd.cli import main
from gcnd.errors import MeshWarning
from gcnd.filters import Filter
from gcnd.mesh_io import MeshArrays, load, save
from gcnd.repeats import without_repeats
from gcnd.runs import Denoised
from sheet_cases import even_sheet, with_noise

Faces = NDArray[np.uint32]

TRUTH, FACES = even_sheet(40)
NOISY = with_noise(TRUTH, seed=0, level=0.1)
BACKS = FACES[:, ::-1]
THIRD = np.sort(np.random.default_rng(1).choice(len(FACES), len(FACES) // 3, replace=False))
EACH = np.arange(len(FACES))

REPEATED: dict[str, tuple[Faces, NDArray[np.int64]]] = {
    "twice": (np.concatenate([FACES, FACES[:, [1, 2, 0]]]), np.concatenate([EACH, EACH])),
    "two-sided": (np.stack([FACES, BACKS], axis=1).reshape(-1, 3), np.repeat(EACH, 2)),
    "some twice": (np.concatenate([FACES, FACES[THIRD]]), np.concatenate([EACH, THIRD])),
    "some backs": (np.concatenate([FACES, BACKS[THIRD]]), np.concatenate([EACH, THIRD])),
    "thrice": (np.concatenate([FACES, BACKS, FACES]), np.concatenate([EACH, EACH, EACH])),
}
"""Faces, and of each the one of the sheet that it is."""


def runner(method: str) -> Denoiser | Filter:
    return Denoiser(method) if method in ("auto", "fast") else Filter(method)


@cache
def of_the_sheet(method: str) -> Denoised:
    return runner(method).run((NOISY, FACES))


@pytest.mark.parametrize("name", REPEATED)
@pytest.mark.parametrize("method", ["fast", "bilateral-normal", "taubin"])
def test_the_result_is_that_of_the_mesh_without(method: str, name: str) -> None:
    faces, same = REPEATED[name]
    with pytest.warns(MeshWarning) as caught:
        done = runner(method).run((NOISY, faces))
    once = of_the_sheet(method)
    assert [str(warning.message) for warning in caught] == [
        f"{len(faces) - 3200:,} of {len(faces):,} faces repeat an earlier one, in the same direction or the other: "
        "they are left out for the work, and the result has the faces of the input"
    ]
    assert np.array_equal(done.mesh[0], once.mesh[0])
    assert np.array_equal(done.mesh[1], faces)
    assert np.sqrt(np.mean(done.after[:, 2] ** 2)) < (0.02 if method == "fast" else 0.05)
    if once.confidence is None:
        assert done.confidence is None
    else:
        assert np.ptp(once.confidence) > 0.01
        assert np.array_equal(done.confidence, once.confidence[same])
    report, wanted = done.report(), once.report()
    for key in ("displacement", "flipped_faces", "noise_level", "spikes"):
        assert report[key] == wanted[key]
    assert report["mesh"].pop("faces") == len(faces)
    assert report["mesh"].items() <= wanted["mesh"].items()
    assert report["warnings"] == [str(caught[0].message)]


def test_auto_reads_the_same_signs() -> None:
    with pytest.warns(MeshWarning, match="faces repeat an earlier one"):
        done = runner("auto").run((NOISY, REPEATED["two-sided"][0]))
    once = of_the_sheet("auto")
    assert done.method == once.method
    assert np.array_equal(done.after, once.after)


def test_the_first_of_repeated_faces_says_which_side_is_out() -> None:
    faces = np.concatenate([BACKS, FACES])
    once, place = without_repeats(MeshArrays(NOISY, faces))
    assert np.array_equal(once.faces, BACKS)
    assert np.array_equal(place, np.concatenate([EACH, EACH]))


def test_controls_are_those_of_the_mesh_without() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    vertices, faces = np.array(ball.vertices), ball.faces.astype(np.uint32)
    controls = Controls(0.8, max_displacement_edges=0.05, keep=vertices[:, 0] > 0.5, preserve_volume=True)
    once = Filter("laplacian", controls=controls).run((vertices, faces))
    with pytest.warns(MeshWarning, match="320 of 640 faces repeat an earlier one"):
        done = Filter("laplacian", controls=controls).run((vertices, np.concatenate([faces, faces[:, ::-1]])))
    assert np.array_equal(done.after, once.after)
    volumes = [value for key, value in done.report()["mesh"].items() if key.startswith("volume")]
    assert volumes == [value for key, value in once.report()["mesh"].items() if key.startswith("volume")]
    assert volumes[0] > 4.0


def test_vertices_at_one_position_are_one() -> None:
    faces, _ = REPEATED["some backs"]
    apart = (NOISY[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3))
    with pytest.warns(MeshWarning, match="1,066 of 4,266 faces repeat an earlier one"):
        done = Filter("taubin").run(apart)
    assert np.abs(done.after.reshape(-1, 3, 3) - of_the_sheet("taubin").after[faces]).max() < 1e-12


def test_the_file_has_a_confidence_for_every_face(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    faces, same = REPEATED["two-sided"]
    save((NOISY, faces), tmp_path / "in.ply")
    program = [
        "denoise",
        str(tmp_path / "in.ply"),
        str(tmp_path / "out.ply"),
        "--preset",
        "fast",
        "--confidence",
    ]
    assert main([*program, "--quiet"]) == 0
    assert capsys.readouterr().err.startswith("warning: 3,200 of 6,400 faces repeat an earlier one")
    written = load(tmp_path / "out.ply")
    assert np.array_equal(written.faces, faces)
    found = written.face_attributes["confidence"]
    assert len(found) == len(faces)
    assert np.array_equal(found[::2], found[1::2])
    # The file has positions of 32 bits.
    expected = Denoiser("fast").run((load(tmp_path / "in.ply").vertices, FACES)).confidence
    assert expected is not None
    assert np.array_equal(found, expected[same].astype(np.float32))


# --- which are repeated ------------------------------------------------------------------------------


def first_of_each(faces: Faces) -> list[int]:
    """An independent loop."""
    seen: dict[tuple[int, ...], int] = {}
    return [seen.setdefault(tuple(sorted(face)), i) for i, face in enumerate(faces.tolist())]


def one_key(faces: Faces) -> NDArray[np.uint64]:
    return np.zeros(len(faces), dtype=np.uint64)


def two_keys(faces: Faces) -> NDArray[np.uint64]:
    return (faces.sum(axis=1) % 2).astype(np.uint64)


@pytest.mark.parametrize("keys", [repeats._keys, one_key, two_keys])
@given(corners=st.lists(st.lists(st.integers(0, 4), min_size=3, max_size=3), min_size=1, max_size=30))
@settings(deadline=None, derandomize=True, database=None)
def test_faces_are_told_apart_by_their_corners(
    keys: Callable[[Faces], NDArray[np.uint64]], corners: list[list[int]]
) -> None:
    faces = np.array(corners, dtype=np.uint32)
    mesh = MeshArrays(np.zeros((5, 3)), faces)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(repeats, "_keys", keys)
        once, place = without_repeats(mesh)
    first = np.array(first_of_each(faces))
    if (first == np.arange(len(faces))).all():
        assert once is mesh
        assert place is None
    else:
        ids = np.unique(first)
        assert np.array_equal(once.faces, faces[ids])
        assert np.array_equal(place, np.searchsorted(ids, first))


def test_keys_do_not_depend_on_the_order_of_corners_and_hardly_meet() -> None:
    rng = np.random.default_rng(0)
    faces = np.sort(rng.integers(0, 2**20, (200_000, 3)), axis=1).astype(np.uint32)
    keys = repeats._keys(faces)
    assert np.array_equal(keys, repeats._keys(faces[:, [2, 0, 1]]))
    assert len(np.unique(keys)) == len(np.unique(faces, axis=0))

"""Pairs of noisy and clean meshes on disk: names, and every way in which they can fail to match."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from gcnd.data.pairs import PairFiles, list_pairs, load_pair
from gcnd.errors import ConfigError, MeshError
from gcnd.mesh_io import save


def write(path: Path, vertices: np.ndarray, faces: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    save(trimesh.Trimesh(vertices, faces, process=False), path)
    return path


@pytest.fixture
def box() -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.box()
    return np.array(mesh.vertices), np.array(mesh.faces)


def test_truths_are_found_by_name(tmp_path: Path, box: tuple[np.ndarray, np.ndarray]) -> None:
    noisy_names = (
        "boy_n1.obj",
        "boy_n2.ply",
        "boy_noisy.obj",
        "part_lp_n1.obj",
        "same.off",
        "part_lp_i3.STL",
    )
    for name in noisy_names:
        write(tmp_path / "train" / "noisy" / name.lower(), *box)
    (tmp_path / "train" / "noisy" / "readme.txt").write_text("no mesh", encoding="utf-8")
    for name in ("boy.obj", "part_lp.ply", "same.obj", "unused.obj"):
        write(tmp_path / "train" / "original" / name, *box)
    found = {pair.noisy.name: pair.clean.name for pair in list_pairs(tmp_path, "train")}
    assert found == {
        "boy_n1.obj": "boy.obj",
        "boy_n2.ply": "boy.obj",
        "boy_noisy.obj": "boy.obj",
        "part_lp_i3.stl": "part_lp.ply",
        "part_lp_n1.obj": "part_lp.ply",
        "same.off": "same.obj",
    }


def test_two_truths_of_one_name_are_refused(tmp_path: Path, box: tuple[np.ndarray, np.ndarray]) -> None:
    write(tmp_path / "train" / "noisy" / "boy_n1.obj", *box)
    write(tmp_path / "train" / "original" / "boy.obj", *box)
    (tmp_path / "train" / "original" / "._boy.obj").write_bytes(b"of another system")
    assert [pair.clean.name for pair in list_pairs(tmp_path, "train")] == ["boy.obj"]
    write(tmp_path / "train" / "original" / "boy.ply", *box)
    with pytest.raises(ConfigError, match=r"boy\.obj and .*boy\.ply are truths of one name"):
        list_pairs(tmp_path, "train")


def test_what_is_missing_is_named(tmp_path: Path, box: tuple[np.ndarray, np.ndarray]) -> None:
    with pytest.raises(ConfigError, match=r"no such folder: .*original"):
        list_pairs(tmp_path, "train")
    write(tmp_path / "train" / "original" / "boy.obj", *box)
    with pytest.raises(ConfigError, match=r"no such folder: .*noisy"):
        list_pairs(tmp_path, "train")
    (tmp_path / "train" / "noisy").mkdir()
    with pytest.raises(ConfigError, match=r"no mesh in .*noisy"):
        list_pairs(tmp_path, "train")
    write(tmp_path / "train" / "noisy" / "girl_n1.obj", *box)
    with pytest.raises(ConfigError, match=r"girl_n1\.obj has no truth") as caught:
        list_pairs(tmp_path, "train")
    assert "girl.obj" in str(caught.value.hint)


def test_a_pair_comes_back_as_written(tmp_path: Path, box: tuple[np.ndarray, np.ndarray]) -> None:
    vertices, faces = box
    pair = PairFiles(write(tmp_path / "a_n1.obj", vertices * 1.5, faces), write(tmp_path / "a.obj", *box))
    noisy, clean, ids = load_pair(pair)
    np.testing.assert_allclose(noisy[ids], (vertices * 1.5)[faces])
    np.testing.assert_allclose(clean[ids], vertices[faces])


def test_the_corners_of_an_stl_are_welded(tmp_path: Path, box: tuple[np.ndarray, np.ndarray]) -> None:
    vertices, faces = box
    pair = PairFiles(write(tmp_path / "a_n1.stl", vertices * 1.5, faces), write(tmp_path / "a.stl", *box))
    noisy, clean, ids = load_pair(pair)
    assert len(noisy) == len(clean) == 8
    np.testing.assert_allclose(clean[ids], vertices[faces])


def test_pairs_that_do_not_match_are_named(tmp_path: Path, box: tuple[np.ndarray, np.ndarray]) -> None:
    vertices, faces = box
    clean = write(tmp_path / "a.ply", *box)
    fewer = write(tmp_path / "fewer.ply", vertices, faces[:-1])
    with pytest.raises(MeshError, match=r"fewer\.ply has 11 faces, its truth .*a\.ply has 12"):
        load_pair(PairFiles(fewer, clean))
    more = write(tmp_path / "more.ply", np.concatenate([vertices, [[9.0, 9, 9]]]), faces)
    with pytest.raises(MeshError, match=r"9 vertices, its truth .* has 8"):
        load_pair(PairFiles(more, clean))
    turned = faces.copy()
    turned[3] = np.roll(turned[3], 1)
    other = write(tmp_path / "turned.ply", vertices, turned)
    with pytest.raises(MeshError, match="differ in face 3"):
        load_pair(PairFiles(other, clean))

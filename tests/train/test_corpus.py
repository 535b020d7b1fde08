"""What a run learns from: shapes, meshes of a folder, pairs on disk, simulated scans."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from train_cases import RECIPE, clean, cube, logged, sphere, use_small_shapes

from gcnd import _geom
from gcnd.data.noise import add_noise
from gcnd.data.shapes_blend import blended
from gcnd.errors import ConfigError, MeshError
from gcnd.mesh_io import save
from gcnd.scans.training import PAIRS_VERSION
from gcnd.train import corpus as corpus_module
from gcnd.train.corpus import (
    FEWEST_FACES,
    N_WARPED,
    SHAPES_AN_EDGED_PART,
    WARPED_WEIGHT,
    generated_corpus,
    given_shapes,
    paired_corpus,
    scanned_corpus,
)
from gcnd.train.recipes import OUR_PATCH, get_recipe
from gcnd.train.run import TrainingRun
from gcnd.train.samples import CleanShape
from gcnd.weights import load_cascade


@pytest.fixture(autouse=True)
def small_shapes(monkeypatch: pytest.MonkeyPatch) -> None:
    use_small_shapes(monkeypatch)


def test_meshes_of_a_folder_are_added_by_kind(tmp_path: Path) -> None:
    for folder in ("cad", "smooth", "other"):
        (tmp_path / folder).mkdir()
    box = trimesh.creation.box()
    save(box, tmp_path / "cad" / "b.ply")
    save(box, tmp_path / "smooth" / "a.obj")
    save(box, tmp_path / "other" / "c.off")
    (tmp_path / "cad" / "notes.txt").write_text("no mesh", encoding="utf-8")
    recipe = replace(RECIPE, n_shapes=SHAPES_AN_EDGED_PART, seed=7)
    shapes = generated_corpus(recipe, tmp_path, tmp_path).shapes
    shapes = [shape for shape in shapes if "warped" not in shape.name]
    assert [(s.name, s.kind) for s in shapes] == [
        ("sphere", "smooth"),
        ("cube", "cad"),
        ("cube, edges blended", "cad"),
        ("edged 7", "cad"),
        ("b", "cad"),
        ("c", "feature"),
        ("a", "smooth"),
    ]
    assert [s.draw_weight for s in shapes] == [1.0, 1.0, 0.6, 1.0, 4.0, 4.0, 4.0]
    assert np.array_equal(shapes[4].vertices, box.vertices)
    assert np.array_equal(shapes[2].vertices, blended(cube(4).vertices, cube(4).faces, 0.5))
    (tmp_path / "empty").mkdir()
    with pytest.raises(ConfigError, match=r"no mesh in .*empty"):
        generated_corpus(RECIPE, tmp_path, tmp_path / "empty")


def test_the_nearest_folder_of_a_kind_gives_it(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    places = {
        "CAD/a": "cad",
        "cad/parts/b": "cad",
        "cad/smooth/c": "smooth",
        "parts/d": "feature",
        "e": "feature",
    }
    for number, place in enumerate(places):
        path = (tmp_path / place).with_suffix(".ply")
        path.parent.mkdir(parents=True, exist_ok=True)
        # Of each its own size, to be told by.
        save((ball.vertices * (number + 1), ball.faces), path)
    (tmp_path / "._hidden.ply").write_bytes(b"of another system")
    shapes = generated_corpus(RECIPE, tmp_path / "shapes", tmp_path).shapes
    kinds = {shape.name: shape.kind for shape in shapes if shape.name in "abcde"}
    assert kinds == {place[-1]: kind for place, kind in places.items()}


def test_a_folder_of_meshes_is_read_before_shapes_are_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: object, **__: object) -> list[CleanShape]:
        raise AssertionError("made")

    monkeypatch.setattr("gcnd.train.corpus.load_generated", never)
    (tmp_path / "broken.ply").write_bytes(b"ply\n")
    for make in (
        lambda: generated_corpus(RECIPE, tmp_path / "shapes", tmp_path),
        lambda: scanned_corpus(get_recipe("scan"), tmp_path / "shapes", tmp_path, tmp_path / "scans"),
    ):
        with pytest.raises(MeshError, match=r"broken\.ply"):
            make()


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[CleanShape]]:
    """What is made of a ball of each kind."""
    folder = tmp_path_factory.mktemp("given")
    made = {}
    for kind, subdivisions in (("smooth", 5), ("cad", 5), ("feature", 4)):
        path = folder / kind / f"{kind}.ply"
        path.parent.mkdir()
        save(trimesh.creation.icosphere(subdivisions=subdivisions), path)
        made[kind] = given_shapes(path, kind)
        again = [shape.vertices for shape in given_shapes(path, kind)]
        assert all(np.array_equal(s.vertices, v) for s, v in zip(made[kind], again, strict=True))
    return made


def test_given_meshes_are_thinned_but_for_machine_parts_and_small_ones(
    given: dict[str, list[CleanShape]],
) -> None:
    sizes = [(s.name, s.kind, len(s.faces), s.draw_weight) for s in given["smooth"][:3]]
    assert sizes == [
        ("smooth", "smooth", 20480, 4.0),
        ("smooth, 1/2 of the faces", "smooth", 10240, 4.0),
        ("smooth, 1/4 of the faces", "smooth", 5120, 4.0),
    ]
    assert {len(s.faces) for s in given["cad"]} == {20480}
    assert [len(s.faces) for s in given["feature"][:-N_WARPED]] == [5120]
    assert np.abs(np.linalg.norm(given["smooth"][2].vertices, axis=1) - 1).max() < 0.01


def quadric_misfit(shape: CleanShape) -> float:
    """How far a shape is from any ellipsoid: the largest error of the quadric through its vertices."""
    x, y, z = shape.vertices.T
    terms = np.stack([x * x, y * y, z * z, x * y, y * z, z * x, x, y, z], axis=1)
    ones = np.ones(len(terms))
    return float(np.abs(terms @ np.linalg.lstsq(terms, ones)[0] - ones).max())


def test_given_meshes_come_stretched_and_bent_besides(given: dict[str, list[CleanShape]]) -> None:
    for kind, shapes in given.items():
        warped = shapes[-N_WARPED:]
        assert [s.name for s in warped] == [f"{kind}, warped {n}" for n in range(1, N_WARPED + 1)]
        assert {(s.kind, s.draw_weight) for s in warped} == {(kind, WARPED_WEIGHT)}
        assert len(shapes) == (3 if kind == "smooth" else 1) + N_WARPED
        for shape in warped:
            assert quadric_misfit(shape) < 1e-5 if kind == "cad" else quadric_misfit(shape) > 1e-3
            assert trimesh.Trimesh(shape.vertices, shape.faces, process=False).volume > 0
    counts = {len(s.faces) for s in given["smooth"][-N_WARPED:]}
    assert len(counts) > 1
    assert min(counts) >= FEWEST_FACES
    assert max(counts) < 20480


def write_dataset(folder: Path) -> None:
    """Two models for training, one for the test, each with two noisy versions."""
    for split, models in (("train", ("ball", "big_box")), ("test", ("egg",))):
        for part in ("noisy", "original"):
            (folder / split / part).mkdir(parents=True)
        for number, model in enumerate(models):
            shape = cube(4) if model == "big_box" else sphere()
            save(
                trimesh.Trimesh(shape.vertices, shape.faces, process=False),
                folder / split / "original" / f"{model}.obj",
            )
            for name, level in ((f"{model}_n1", 0.1), (f"{model}_noisy", 0.3)):
                noisy = add_noise(shape.vertices, shape.faces, level=level, seed=number)
                save(
                    trimesh.Trimesh(noisy, shape.faces, process=False),
                    folder / split / "noisy" / f"{name}.obj",
                )


def test_a_run_on_pairs_learns_from_them_alone(tmp_path: Path) -> None:
    write_dataset(tmp_path / "data")
    corpus = paired_corpus(tmp_path / "data")
    names = ["ball_n1", "ball_noisy", "big_box_n1", "big_box_noisy"]
    assert [shape.name for shape in corpus.shapes] == names
    assert [mesh.shape.name for mesh in corpus.validation] == ["egg_n1", "egg_noisy"]
    rng = np.random.default_rng(0)
    drawn = [corpus.source.draw(rng) for _ in range(60)]
    assert sorted({mesh.shape.name for mesh in drawn}) == names
    edge = sphere_edge()
    for shape, vertices, *_ in drawn:
        moved = np.linalg.norm(vertices - shape.vertices, axis=1).std()
        assert 0 < moved < 0.5 * max(edge, shape.noise.mean_edge)
    path = TrainingRun(tmp_path / "run", RECIPE, corpus, validate_every=5).run()
    assert len(load_cascade(str(path)).passes()) == 3
    assert all(0 < line["validation_e_a"] < 90 for line in logged(tmp_path / "run"))


def sphere_edge() -> float:
    return clean(sphere()).noise.mean_edge


def test_a_run_on_scans_learns_from_scans_of_the_shapes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use_small_shapes(monkeypatch)
    monkeypatch.setattr(corpus_module, "N_VALIDATION", 4)
    recipe = replace(RECIPE, name="scan", data="scans", n_scans=2, pool_size=1)
    told: list[str] = []
    corpus = scanned_corpus(recipe, tmp_path, None, tmp_path / "scans", told.append)
    assert told[-1] == f"scans: {recipe.n_scans} of {recipe.n_scans} made"
    told.clear()
    again = scanned_corpus(recipe, tmp_path, None, tmp_path / "scans", told.append)
    assert not told, "nothing is made twice"
    assert len(corpus.shapes) == 2
    # Every second scan is cut off.
    for number, shape in enumerate(corpus.shapes):
        name = f"scan-v{PAIRS_VERSION}-{recipe.seed:08d}-{number:06d}.npz"
        n_faces = len(np.load(tmp_path / "scans" / name)["faces"])
        assert len(shape.faces) < n_faces if number else len(shape.faces) == n_faces
    kinds = [mesh.shape.name.split("-")[1] for mesh in corpus.validation]
    assert kinds == ["kinect1", "kinect2", "fusion", "print"]
    for mesh, same in zip(corpus.validation, again.validation, strict=True):
        assert np.array_equal(mesh.vertices, same.vertices)
        angles = _geom.normal_angles(
            _geom.face_geometry(mesh.vertices, mesh.shape.faces)[0], mesh.shape.normals
        )
        assert 3 < np.nanmean(angles) < 45
    assert len(list((tmp_path / "scans").glob("*.npz"))) == 6
    small = replace(corpus, validation=corpus.validation[3:4])
    path = TrainingRun(tmp_path / "run", recipe, small, validate_every=5).run()
    assert path.name == "scan.safetensors"
    assert len(load_cascade(str(path)).passes()) == 3
    with pytest.raises(ConfigError, match="n_scans of recipe scan is 0, allowed: 1 or more"):
        scanned_corpus(replace(recipe, n_scans=0), tmp_path, None, tmp_path / "scans")


def test_the_scan_recipe_is_the_defaults_first_network_on_scans() -> None:
    scan, default = get_recipe("scan"), get_recipe("default")
    theirs = default.stages[0].stage
    for ours, other in zip(scan.stages, default.stages, strict=True):
        assert ours.stage.network == theirs.network
        assert ours.stage.patch == replace(theirs.patch, patch_scale=8.0, n_nodes=256)
        assert ours.stage.passes == other.stage.passes
        assert ours.stage.patch.n_nodes * ours.batch == theirs.patch.n_nodes * other.batch
    assert theirs.patch == OUR_PATCH
    assert (scan.data, default.data) == ("scans", "noise")
    assert scan.n_scans > 100

"""A whole training run in small: weights that load and denoise, and the same weights after any interruption."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from train_cases import STAGE, TRAIN, clean, cube, sphere

from gcnd.data import shape_cache
from gcnd.data.noise import add_noise
from gcnd.data.shapes import Shape
from gcnd.data.shapes_blend import blended
from gcnd.denoise import denoise, denoise_arrays
from gcnd.errors import ConfigError
from gcnd.mesh_io import save
from gcnd.nn.cascade import Cascade, RefinementConfig, StageConfig
from gcnd.nn.networks import build_network
from gcnd.train import corpus as corpus_module
from gcnd.train import run as run_module
from gcnd.train.corpus import generated_corpus, given_shapes, paired_corpus, scanned_corpus
from gcnd.train.loop import StepReport
from gcnd.train.recipes import RECIPES, Recipe, get_recipe
from gcnd.train.run import TrainingRun, adapted, append_line, widened
from gcnd.weights import load_cascade
from gcnd.weights.files import load_tensors

RECIPE = replace(
    get_recipe("default"),
    name="tiny",
    stages=(
        replace(TRAIN, steps=5),
        replace(TRAIN, stage=replace(STAGE, passes=2), steps=4, seed=4),
    ),
    n_shapes=2,
    pool_size=2,
    refinement=RefinementConfig(iterations=3, sigma_r=0.2, tolerance=1.1),
)


class KilledError(Exception):
    """Stands for the end of the process."""


def use_small_shapes(patched: pytest.MonkeyPatch) -> None:
    """Two small shapes in place of the procedural ones, and a checkpoint after every step."""

    def load_shapes(n: int, seed: int, directory: Path) -> list[Shape]:
        return [sphere(), cube(4)][: 1 if seed == corpus_module.VALIDATION_SEED else n]

    patched.setattr(shape_cache, "load_shapes", load_shapes)
    patched.setattr(run_module, "CHECKPOINT_SECONDS", -1.0)


@pytest.fixture(autouse=True)
def small_shapes(monkeypatch: pytest.MonkeyPatch) -> None:
    use_small_shapes(monkeypatch)


def run(
    folder: Path, recipe: Recipe = RECIPE, kill_at: tuple[int, int] | None = None, **options: Any
) -> Path:
    """Runs a recipe; with `kill_at`, ends as a killed process would at that (stage, step), nothing saved."""

    def on_step(stage: int, report: StepReport) -> None:
        if (stage, report.step) == kill_at:
            raise KilledError

    corpus = generated_corpus(recipe, folder, None)
    return TrainingRun(folder, recipe, corpus, validate_every=2, on_step=on_step, **options).run()


@pytest.fixture(scope="module")
def straight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run that nothing disturbed."""
    folder = tmp_path_factory.mktemp("straight")
    with pytest.MonkeyPatch.context() as patched:
        use_small_shapes(patched)
        run(folder)
    return folder


def logged(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "log.jsonl").read_text(encoding="utf-8").splitlines()]


def assert_same_weights(found: Path, expected: Path) -> None:
    (tensors, header), (wanted, wanted_header) = load_tensors(found), load_tensors(expected)
    assert header == wanted_header
    assert tensors.keys() == wanted.keys()
    assert all(torch.equal(tensors[name], tensor) for name, tensor in wanted.items())


def test_a_run_ends_with_weights_that_denoise(straight: Path) -> None:
    path = straight / "tiny.safetensors"
    cascade = load_cascade(str(path))
    assert [stage for stage, _ in cascade.passes()] == [
        RECIPE.stages[0].stage,
        RECIPE.stages[1].stage,
        RECIPE.stages[1].stage,
    ]
    assert cascade.config.refinement == RECIPE.refinement
    assert cascade.config.vertex_iterations == 15
    assert load_tensors(path)[1]["recipe"] == "tiny"
    shape = sphere()
    noisy = add_noise(shape.vertices, shape.faces, level=0.3, seed=5)
    vertices, faces = denoise((noisy, shape.faces), preset=str(path))
    assert np.array_equal(faces, shape.faces)
    # The same as the trained networks themselves give, stage by stage, before their BatchNorm is folded in.
    trained = Cascade(cascade.config)
    for number, network in enumerate(trained.stages, start=1):
        network.load_state_dict(load_tensors(straight / f"stage{number}.safetensors")[0])
    expected = denoise_arrays(noisy, shape.faces, trained.eval())
    assert np.abs(vertices - expected).max() < 1e-5
    assert np.abs(vertices - noisy).max() > 1e-3


def test_examples_show_the_cascade_at_work(straight: Path) -> None:
    with np.load(straight / "example-1.npz") as example:
        assert str(example["name"]) == "sphere"
        assert np.array_equal(example["clean"], sphere().vertices)
        cascade = load_cascade(str(straight / "tiny.safetensors"))
        assert np.allclose(denoise_arrays(example["noisy"], example["faces"], cascade), example["denoised"])


def test_the_weights_are_the_averages_of_each_stage(straight: Path) -> None:
    cascade = load_tensors(straight / "tiny.safetensors")[0]
    for number, name in enumerate(("stage1", "stage2")):
        stage = load_tensors(straight / f"{name}.safetensors")[0]
        checkpoint = load_tensors(straight / f"{name}.checkpoint.safetensors")[0]
        for key, tensor in stage.items():
            assert torch.equal(tensor, checkpoint[f"average.{key}"])
            assert torch.equal(tensor, cascade[f"stages.{number}.{key}"])
    assert any(not torch.equal(cascade[f"stages.0.{key}"], cascade[f"stages.1.{key}"]) for key in stage)


def test_the_log_says_how_it_went(straight: Path) -> None:
    lines = logged(straight)
    assert [(line["stage"], line["step"]) for line in lines] == [(1, 2), (1, 4), (1, 5), (2, 2), (2, 4)]
    assert all(line.keys() >= {"time", "loss", "validation_e_a"} for line in lines)
    assert all(0 < line["loss"] < 2 and 0 < line["validation_e_a"] < 90 for line in lines)
    assert all(line["patches_per_second"] > 0 for line in lines)


@pytest.mark.parametrize("kill_at", [(0, 1), (0, 4), (1, 1), (1, 3)])
def test_killed_anywhere_it_goes_on_to_the_same_weights(
    straight: Path, tmp_path: Path, kill_at: tuple[int, int]
) -> None:
    with pytest.raises(KilledError):
        run(tmp_path, kill_at=kill_at)
    assert not (tmp_path / "tiny.safetensors").exists()
    said: list[str] = []
    assert run(tmp_path, on_event=said.append) == tmp_path / "tiny.safetensors"
    stage, step = kill_at
    resumed = [line for line in said if "resumed" in line]
    assert resumed == ([f"stage {stage + 1}: resumed at step {step - 1}"] if step > 1 else [])
    assert_same_weights(tmp_path / "tiny.safetensors", straight / "tiny.safetensors")


def test_killed_between_stage_and_cascade_nothing_is_trained_again(straight: Path, tmp_path: Path) -> None:
    with pytest.raises(KilledError):
        run(tmp_path, kill_at=(1, 4))
    run(tmp_path)
    for name in ("tiny.safetensors", "stage2.safetensors"):
        (tmp_path / name).unlink()
    steps: list[int] = []
    corpus = generated_corpus(RECIPE, tmp_path, None)
    TrainingRun(tmp_path, RECIPE, corpus, on_step=lambda stage, report: steps.append(report.step)).run()
    assert steps == []
    assert_same_weights(tmp_path / "tiny.safetensors", straight / "tiny.safetensors")


def test_a_second_stage_starts_from_the_first_where_layouts_agree(tmp_path: Path) -> None:
    def first_steps(folder: Path, recipe: Recipe) -> dict[str, torch.Tensor]:
        with pytest.raises(KilledError):
            run(folder, recipe, kill_at=(1, 2))
        return load_tensors(folder / "stage2.checkpoint.safetensors")[0]

    frozen = replace(RECIPE, stages=(RECIPE.stages[0], replace(RECIPE.stages[1], lr=0.0)))
    cold = replace(frozen, warm_start=False)
    stage1 = None
    for name, recipe, as_before in (("warm", frozen, True), ("cold", cold, False)):
        checkpoint = first_steps(tmp_path / name, recipe)
        stage1 = load_tensors(tmp_path / name / "stage1.safetensors")[0]
        weights = [key for key in stage1 if key.endswith("weight") and "norm" not in key]
        same = all(torch.equal(checkpoint[f"network.{key}"], stage1[key]) for key in weights)
        assert same == as_before


def test_a_run_starts_from_given_weights_stage_by_stage(straight: Path, tmp_path: Path) -> None:
    frozen = replace(RECIPE, stages=tuple(replace(stage, lr=0.0) for stage in RECIPE.stages))
    run(tmp_path, frozen, start_from=str(straight / "tiny.safetensors"))
    for name in ("stage1", "stage2"):
        found, given = (load_tensors(f / f"{name}.safetensors")[0] for f in (tmp_path, straight))
        weights = [key for key in given if key.endswith("weight") and "norm" not in key]
        assert weights
        assert all(torch.equal(found[key], given[key]) for key in weights)


@pytest.mark.parametrize(
    "channels", [{"scale_space": True}, {"roughness": True}, {"scale_space": True, "roughness": True}]
)
def test_weights_widened_for_new_channels_answer_the_same(channels: dict[str, bool]) -> None:
    patch = replace(STAGE.patch, **channels)
    wider = replace(STAGE, network=replace(STAGE.network, in_channels=patch.n_channels), patch=patch)
    torch.manual_seed(5)
    narrow = build_network(STAGE.network)
    torch.nn.init.normal_(narrow.out.weight)
    wide = build_network(wider.network)
    wide.load_state_dict(widened(narrow.state_dict(), STAGE, wider))
    features = torch.randn(3, 32, patch.n_channels)
    neighbors = torch.randint(0, 32, (3, 32, 3), dtype=torch.int32)
    expected = narrow.eval()(features[..., :17], neighbors)
    assert torch.allclose(wide.eval()(features, neighbors), expected, atol=1e-5)


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        (
            replace(
                STAGE,
                network=replace(STAGE.network, in_channels=26),
                patch=replace(STAGE.patch, scale_space=True),
            ),
            STAGE,
        ),
        (STAGE, replace(STAGE, network=replace(STAGE.network, knn_k=5))),
        (STAGE, replace(STAGE, patch=replace(STAGE.patch, n_nodes=48))),
        (STAGE, replace(STAGE, patch=replace(STAGE.patch, vertex_offsets=False, scale_space=True))),
        (
            replace(
                STAGE,
                network=replace(STAGE.network, in_channels=21),
                patch=replace(STAGE.patch, roughness=True),
            ),
            replace(
                STAGE,
                network=replace(STAGE.network, in_channels=30),
                patch=replace(STAGE.patch, roughness=True, scale_space=True),
            ),
        ),
    ],
    ids=["fewer channels", "other network", "other patches", "other channels", "channels in between"],
)
def test_weights_of_another_layout_are_refused(given: StageConfig, wanted: StageConfig) -> None:
    with pytest.raises(ConfigError, match="another layout"):
        widened(build_network(given.network).state_dict(), given, wanted)


def test_a_finished_stage_of_other_settings_is_refused(straight: Path, tmp_path: Path) -> None:
    (tmp_path / "stage1.safetensors").write_bytes((straight / "stage1.safetensors").read_bytes())
    longer = replace(RECIPE, stages=(replace(RECIPE.stages[0], steps=50), RECIPE.stages[1]))
    with pytest.raises(ConfigError, match=r"stage1\.safetensors was trained with other settings"):
        run(tmp_path, longer)


def test_a_line_cut_short_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "log"
    append_line(path, "one")
    with path.open("ab") as file:
        file.write(b"tw")
    append_line(path, "three")
    assert path.read_bytes() == b"one\nthree\n"


# --- what a run is made of -----------------------------------------------------------------------------


def test_meshes_of_a_folder_are_added_by_kind(tmp_path: Path) -> None:
    for folder in ("cad", "smooth", "other"):
        (tmp_path / folder).mkdir()
    box = trimesh.creation.box()
    save(box, tmp_path / "cad" / "b.ply")
    save(box, tmp_path / "smooth" / "a.obj")
    save(box, tmp_path / "other" / "c.off")
    (tmp_path / "cad" / "notes.txt").write_text("no mesh", encoding="utf-8")
    shapes = generated_corpus(RECIPE, tmp_path, tmp_path).shapes
    assert [(s.name, s.kind) for s in shapes] == [
        ("sphere", "smooth"),
        ("cube", "cad"),
        ("cube, edges blended", "cad"),
        ("b", "cad"),
        ("c", "feature"),
        ("a", "smooth"),
    ]
    assert [s.draw_weight for s in shapes] == [1.0, 1.0, 0.6, 4.0, 4.0, 4.0]
    assert np.array_equal(shapes[3].vertices, box.vertices)
    assert np.array_equal(shapes[2].vertices, blended(cube(4).vertices, cube(4).faces, 0.5))
    (tmp_path / "empty").mkdir()
    with pytest.raises(ConfigError, match=r"no mesh in .*empty"):
        generated_corpus(RECIPE, tmp_path, tmp_path / "empty")


def test_given_meshes_are_thinned_but_for_machine_parts_and_small_ones(tmp_path: Path) -> None:
    for kind, subdivisions in (("smooth", 5), ("cad", 5), ("feature", 4)):
        (tmp_path / kind).mkdir()
        save(trimesh.creation.icosphere(subdivisions=subdivisions), tmp_path / kind / f"{kind}.ply")
    sizes = {
        kind: [
            (s.name, s.kind, len(s.faces), s.draw_weight)
            for s in given_shapes(tmp_path / kind / f"{kind}.ply")
        ]
        for kind in ("smooth", "cad", "feature")
    }
    assert sizes["smooth"] == [
        ("smooth", "smooth", 20480, 4.0),
        ("smooth, 1/2 of the faces", "smooth", 10240, 4.0),
        ("smooth, 1/4 of the faces", "smooth", 5120, 4.0),
    ]
    assert [s[2] for s in sizes["cad"]] == [20480]
    assert [s[2] for s in sizes["feature"]] == [5120]
    thinned = given_shapes(tmp_path / "smooth" / "smooth.ply")[2]
    assert np.abs(np.linalg.norm(thinned.vertices, axis=1) - 1).max() < 0.01


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
    for shape, vertices, _ in drawn:
        moved = np.linalg.norm(vertices - shape.vertices, axis=1).std()
        assert 0 < moved < 0.5 * max(edge, shape.noise.mean_edge)
    path = TrainingRun(tmp_path / "run", RECIPE, corpus, validate_every=5).run()
    assert len(load_cascade(str(path)).passes()) == 3
    assert all(0 < line["validation_e_a"] < 90 for line in logged(tmp_path / "run"))


def sphere_edge() -> float:
    return clean(sphere()).noise.mean_edge


def test_adapted_scales_the_steps_and_sets_the_precision(monkeypatch: pytest.MonkeyPatch) -> None:
    recipe = get_recipe("default")
    scaled = adapted(recipe, scale=0.5, precision="bfloat16")
    assert [s.steps for s in scaled.stages] == [round(s.steps * 0.5) for s in recipe.stages]
    assert {s.precision for s in scaled.stages} == {"bfloat16"}
    assert [s.steps for s in adapted(recipe, scale=1e-9).stages] == [1] * len(recipe.stages)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "is_bf16_supported", lambda: False)
    assert {s.precision for s in adapted(recipe, device="cuda").stages} == {"float32"}
    for fast, precision in ((True, "bfloat16"), (False, "float32")):
        monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda fast=fast: fast)
        assert {s.precision for s in adapted(recipe).stages} == {precision}
        assert {s.precision for s in adapted(get_recipe("paper")).stages} == {"float32"}
    with pytest.raises(ConfigError, match="precision is 'half'"):
        adapted(recipe, precision="half")


def test_recipes() -> None:
    assert {name: recipe.name for name, recipe in RECIPES.items()} == {
        n: n for n in ("default", "fast", "paper", "scan")
    }
    with pytest.raises(
        ConfigError, match="unknown training preset 'papers', allowed: default, fast, paper, scan"
    ):
        get_recipe("papers")
    for recipe in RECIPES.values():
        for stage in recipe.stages:
            assert stage.chunk.n_patches % stage.batch == 0
            assert stage.chunk.n_patches % stage.chunk.n_meshes == 0
    paper = get_recipe("paper")
    assert not paper.warm_start
    assert {(s.batch, s.lr, s.loss, s.chunk.balance_ratio) for s in paper.stages} == {(128, 1e-4, "mse", 1.5)}
    assert {s.stage.patch.budget for s in paper.stages} == {"random"}


def test_a_run_on_scans_learns_from_scans_of_the_shapes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use_small_shapes(monkeypatch)
    monkeypatch.setattr(corpus_module, "N_VALIDATION", 4)
    recipe = replace(RECIPE, name="scan", data="scans", n_scans=2, pool_size=1)
    corpus = scanned_corpus(recipe, tmp_path, None, tmp_path / "scans")
    again = scanned_corpus(recipe, tmp_path, None, tmp_path / "scans")
    assert len(corpus.shapes) == 2
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


def test_the_scan_recipe_is_the_defaults_networks_on_scans() -> None:
    scan, default = get_recipe("scan"), get_recipe("default")
    assert [s.stage for s in scan.stages] == [s.stage for s in default.stages]
    assert (scan.data, default.data) == ("scans", "noise")
    assert scan.n_scans > 100

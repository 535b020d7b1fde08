"""A whole training run in small: weights that load and denoise, and the same weights after any interruption."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from train_cases import RECIPE, logged, sphere, use_small_shapes

from gcnd.data.noise import add_noise
from gcnd.denoise import denoise, denoise_arrays
from gcnd.errors import ConfigError, WeightsError
from gcnd.nn.cascade import Cascade
from gcnd.train.corpus import PairSource, generated_corpus
from gcnd.train.loop import StepReport
from gcnd.train.recipes import RECIPES, Recipe, get_recipe
from gcnd.train.run import TrainingRun, adapted, append_line
from gcnd.weights import load_cascade
from gcnd.weights.files import load_tensors, save_tensors


class KilledError(Exception):
    """Stands for the end of the process."""


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


def test_a_stage_that_runs_twice_learns_from_its_own_first_pass(straight: Path, tmp_path: Path) -> None:
    """Where the weights to start from have it: every third mesh of its pool has had a pass of theirs."""
    given = tmp_path / "given.safetensors"
    tensors, header = load_tensors(straight / "tiny.safetensors")
    # What predicts the normals that there are moves no vertex.
    tensors["stages.1.out.weight"] = torch.full_like(tensors["stages.1.out.weight"], 0.1)
    save_tensors(given, tensors, header)
    first, second = (replace(stage, lr=0.0) for stage in RECIPE.stages)
    for name, passes in (("twice", 2), ("once", 1)):
        stage = replace(second.stage, passes=passes)
        recipe = replace(RECIPE, stages=(first, replace(second, stage=stage)), pool_size=3)
        run(tmp_path / name, recipe, start_from=str(given))
    files = [tmp_path / name / "stage2.pool" for name in ("twice", "once")]
    same = []
    for number in range(3):
        ours, theirs = (np.load(folder / f"{number:04d}.npz")["vertices"] for folder in files)
        same.append(np.array_equal(ours, theirs))
    assert same == [True, True, False]


def test_own_passes_have_the_coverage_that_they_have_at_run_time(straight: Path, tmp_path: Path) -> None:
    corpus = generated_corpus(RECIPE, tmp_path, None)
    training = TrainingRun(tmp_path, RECIPE, corpus, start_from=str(straight / "tiny.safetensors"))
    stage = replace(RECIPE.stages[1].stage, passes=3, coverage=0.9, early_coverage=0.4)
    assert [own.coverage for own, _ in training._own_passes(1, stage)] == [0.4, 0.4]
    assert training._own_passes(1, replace(stage, passes=1)) == []
    assert training._own_passes(2, stage) == []


def test_a_finished_stage_of_other_settings_is_refused(straight: Path, tmp_path: Path) -> None:
    (tmp_path / "stage1.safetensors").write_bytes((straight / "stage1.safetensors").read_bytes())
    longer = replace(RECIPE, stages=(replace(RECIPE.stages[0], steps=50), RECIPE.stages[1]))
    with pytest.raises(ConfigError, match=r"stage1\.safetensors was trained with other settings"):
        run(tmp_path, longer)


def test_a_run_does_not_go_on_with_other_meshes_weights_or_seeds(straight: Path, tmp_path: Path) -> None:
    run(tmp_path)
    before = (tmp_path / "tiny.safetensors").read_bytes()
    for recipe, options, told in (
        (replace(RECIPE, seed=RECIPE.seed + 1), {}, "other recipe$"),
        (replace(RECIPE, pool_size=RECIPE.pool_size + 1), {}, "other recipe$"),
        (RECIPE, {"start_from": str(straight / "tiny.safetensors")}, "other weights to start from$"),
    ):
        with pytest.raises(ConfigError, match=told):
            run(tmp_path, recipe, **options)
    corpus = generated_corpus(RECIPE, tmp_path, None)
    fewer = replace(corpus, shapes=corpus.shapes[1:])
    with pytest.raises(ConfigError, match=r"holds a run with other meshes$"):
        TrainingRun(tmp_path, RECIPE, fewer)
    pairs = replace(corpus, source=PairSource(corpus.validation))
    with pytest.raises(ConfigError, match=r"holds a run with other meshes$"):
        TrainingRun(tmp_path, RECIPE, pairs)
    (tmp_path / "run.json").write_text("{")
    with pytest.raises(ConfigError, match=r"run\.json is damaged"):
        run(tmp_path)
    (tmp_path / "run.json").unlink()
    run(tmp_path)
    assert (tmp_path / "tiny.safetensors").read_bytes() == before


def test_damaged_weights_of_a_run_are_named(straight: Path, tmp_path: Path) -> None:
    tensors, header = load_tensors(straight / "stage1.safetensors")
    tensors.pop(next(iter(tensors)))
    save_tensors(tmp_path / "stage1.safetensors", tensors, header)
    with pytest.raises(WeightsError, match=r"stage1\.safetensors does not hold the weights of its network"):
        run(tmp_path)
    (tmp_path / "stage1.safetensors").unlink()
    tensors, header = load_tensors(straight / "stage1.checkpoint.safetensors")
    parts = [
        ({k: v for k, v in tensors.items() if not k.startswith(part)}, header)
        for part in ("network.out", "average.out", "optimizer.0")
    ]
    for kept, told in (*parts, (tensors, {k: v for k, v in header.items() if k != "step"})):
        save_tensors(tmp_path / "stage1.checkpoint.safetensors", kept, told)
        with pytest.raises(WeightsError, match=r"stage1\.checkpoint\.safetensors") as raised:
            run(tmp_path)
        assert raised.value.hint == "delete it; the run goes on from what is left"


@pytest.mark.skipif(os.name == "nt", reason="permissions of another kind")
def test_weights_have_the_permissions_of_any_file(straight: Path, tmp_path: Path) -> None:
    (tmp_path / "any").touch()
    expected = (tmp_path / "any").stat().st_mode
    assert {path.stat().st_mode for path in straight.glob("*.safetensors")} == {expected}


def test_a_step_tells_the_last_validation(tmp_path: Path) -> None:
    corpus = generated_corpus(RECIPE, tmp_path, None)
    told: list[tuple[int, int, float | None]] = []

    def on_step(stage: int, report: StepReport) -> None:
        told.append((stage, report.step, report.validation))

    TrainingRun(tmp_path, RECIPE, corpus, validate_every=2, on_step=on_step).run()
    logged_errors = [line["validation_e_a"] for line in logged(tmp_path)]
    assert told[:5] == [
        (0, 1, None),
        (0, 2, None),
        *((0, s, logged_errors[(s - 1) // 2 - 1]) for s in (3, 4, 5)),
    ]
    assert told[5][2] is None


def test_a_line_cut_short_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "log"
    append_line(path, "one")
    with path.open("ab") as file:
        file.write(b"tw")
    append_line(path, "three")
    assert path.read_bytes() == b"one\nthree\n"


# --- what a run is made of -----------------------------------------------------------------------------


def test_adapted_scales_the_steps_and_sets_the_precision(monkeypatch: pytest.MonkeyPatch) -> None:
    recipe = get_recipe("default")
    scaled = adapted(recipe, scale=0.5, precision="bfloat16")
    assert [s.steps for s in scaled.stages] == [round(s.steps * 0.5) for s in recipe.stages]
    assert {s.precision for s in scaled.stages} == {"bfloat16"}
    assert [s.steps for s in adapted(recipe, scale=1e-9).stages] == [1] * len(recipe.stages)
    for scale in (0.0, -1.0, float("inf"), float("nan"), 1e30):
        with pytest.raises(ConfigError, match=f"scale is {re.escape(str(scale))}, allowed: above 0, up to"):
            adapted(recipe, scale=scale)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "is_bf16_supported", lambda: False)
    assert {s.precision for s in adapted(recipe, device="cuda").stages} == {"float32"}
    for fast, precision in ((True, "bfloat16"), (False, "float32")):
        monkeypatch.setattr(torch.cpu, "_is_avx512_bf16_supported", lambda fast=fast: fast)
        assert {s.precision for s in adapted(recipe).stages} == {precision}
        for paper in ("paper", "paper-scan"):
            assert {s.precision for s in adapted(get_recipe(paper)).stages} == {"float32"}
    with pytest.raises(ConfigError, match="precision is 'half'"):
        adapted(recipe, precision="half")


def test_recipes() -> None:
    assert {name: recipe.name for name, recipe in RECIPES.items()} == {
        n: n for n in ("default", "fast", "paper", "scan", "paper-scan")
    }
    with pytest.raises(
        ConfigError, match="unknown training preset 'papers', allowed: default, fast, paper, scan, paper-scan"
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
    for_scans = get_recipe("paper-scan")
    assert for_scans.data == "scans"
    assert [s.stage.network for s in for_scans.stages] == [s.stage.network for s in paper.stages]
    assert {(s.stage.patch.patch_scale, s.stage.patch.n_nodes) for s in for_scans.stages} == {(8.0, 256)}

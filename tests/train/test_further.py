"""Further stages than the recipe's: kept while the validation meshes gain, judged once."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from train_cases import RECIPE, clean, sphere, use_small_shapes

from gcnd.cli import main
from gcnd.errors import ConfigError
from gcnd.metrics import normal_error
from gcnd.train import run as run_module
from gcnd.train.corpus import generated_corpus
from gcnd.train.further import Verdict, mean_error, read_verdict, with_further_stages
from gcnd.train.recipes import Recipe
from gcnd.train.run import TrainingRun
from gcnd.train.samples import NoiseDraw, NoisyMesh, noisy_vertices
from gcnd.weights import load_cascade


@pytest.fixture(autouse=True)
def small_shapes(monkeypatch: pytest.MonkeyPatch) -> None:
    use_small_shapes(monkeypatch)


def run(folder: Path, recipe: Recipe) -> tuple[Path, list[str]]:
    """Runs a recipe; the weights, and what was said."""
    said: list[str] = []
    training = TrainingRun(folder, recipe, generated_corpus(recipe, folder, None), on_event=said.append)
    return training.run(), said


def errors_are(monkeypatch: pytest.MonkeyPatch, *errors: float) -> Iterator[float]:
    """Lets the validation meshes have these errors, one after the other; returns what is left of them."""
    left = iter(errors)
    monkeypatch.setattr(run_module, "mean_error", lambda _: next(left))
    return left


def test_further_stages_are_like_the_last_with_seeds_of_their_own() -> None:
    stages = list(with_further_stages(RECIPE.stages, 4))
    assert tuple(stages[:2]) == RECIPE.stages
    assert [replace(stage, seed=0) for stage in stages[2:]] == [replace(RECIPE.stages[1], seed=0)] * 2
    assert len({stage.seed for stage in stages[1:]}) == 3
    assert tuple(with_further_stages(RECIPE.stages, 0)) == RECIPE.stages


def test_the_cascade_grows_while_it_gains(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recipe = replace(RECIPE, most_stages=6)
    left = errors_are(monkeypatch, 4.0, 3.0, 3.0, 2.98, 99.0)
    weights, said = run(tmp_path, recipe)
    # The fourth stage gains less than a hundredth: it is left out, and there is no fifth.
    assert list(left) == [99.0]
    assert load_cascade(str(weights)).config.stages == (RECIPE.stages[0].stage, *[RECIPE.stages[1].stage] * 2)
    assert [line for line in said if "without it" in line] == [
        "stage 3: 4.000° without it, 3.000° with it; it stays",
        "stage 4: 3.000° without it, 2.980° with it; it is left out, and the cascade is done",
    ]
    assert not (tmp_path / "stage5.safetensors").exists()

    written = weights.read_bytes()
    errors_are(monkeypatch)
    assert run(tmp_path, recipe)[0].read_bytes() == written


def test_without_being_asked_no_stage_is_added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    left = errors_are(monkeypatch, 4.0, 3.0)
    weights, _ = run(tmp_path, RECIPE)
    assert list(left) == [4.0, 3.0]
    assert len(load_cascade(str(weights)).config.stages) == 2


def test_a_further_stage_is_judged_by_the_meshes_that_come_out(tmp_path: Path) -> None:
    recipe = replace(RECIPE, most_stages=3)
    run(tmp_path, recipe)
    stored = json.loads((tmp_path / "stage3.json").read_text(encoding="utf-8"))
    noisy = mean_error(generated_corpus(recipe, tmp_path, None).validation)
    # A few steps change little, but both were measured, and on meshes that were denoised.
    assert stored["before"] != stored["after"]
    assert stored["before"] != noisy
    assert abs(stored["before"] - noisy) < 0.5 * noisy
    assert (tmp_path / "stage3.pool").is_dir()


@pytest.mark.parametrize(
    ("before", "after", "is_better"),
    [(4.0, 3.9, True), (4.0, 3.97, False), (4.0, 5.0, False), (4.0, np.nan, False)],
)
def test_a_hundredth_is_the_least_gain(before: float, after: float, is_better: bool) -> None:
    assert Verdict(before, after).is_better == is_better


def test_the_error_is_the_mean_angle_to_the_clean_normals() -> None:
    shape = clean(sphere())
    meshes = [
        NoisyMesh.untouched(shape, noisy_vertices(shape, NoiseDraw("gaussian", level, 0.0, 1)))
        for level in (0.1, 0.4)
    ]
    each = [normal_error(mesh.vertices, shape.vertices, shape.faces) for mesh in meshes]
    assert mean_error(meshes) == pytest.approx(np.mean(each))
    assert mean_error([NoisyMesh.untouched(shape, shape.vertices)]) == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("text", ["", "[]", '{"before": 1.0}', '{"before": "x", "after": 1.0}'])
def test_a_damaged_verdict_is_named(tmp_path: Path, text: str) -> None:
    path = tmp_path / "stage3.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"stage3\.json is damaged"):
        read_verdict(path)


def test_a_kill_before_the_verdict_changes_nothing(tmp_path: Path) -> None:
    recipe = replace(RECIPE, most_stages=3)
    weights, _ = run(tmp_path, recipe)
    written, verdict = weights.read_bytes(), (tmp_path / "stage3.json").read_bytes()
    (tmp_path / "stage3.json").unlink()
    weights.unlink()
    assert run(tmp_path, recipe)[0].read_bytes() == written
    assert (tmp_path / "stage3.json").read_bytes() == verdict


def test_a_further_stage_has_noise_of_its_own(tmp_path: Path) -> None:
    run(tmp_path, replace(RECIPE, most_stages=3))
    second, third = (np.load(tmp_path / f"stage{n}.pool" / "0000.npz") for n in (2, 3))
    assert not np.array_equal(second["first"], third["first"])


def test_fewer_stages_than_the_recipe_has_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", "--preset", "default", "--most-stages", "1", "--out", str(tmp_path / "run")]) == 1
    assert "most_stages is 1, but default has 2 of its own" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_the_command_passes_the_most_stages_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[int] = []
    monkeypatch.setattr("gcnd.cli.train._train", lambda _, recipe, *rest: seen.append(recipe.most_stages))
    for options in (["--most-stages", "4"], []):
        assert main(["train", "--out", str(tmp_path / "run"), *options]) == 0
    assert seen == [4, 0]

"""The training loop: resuming bit for bit, the learning rate, the average of the weights, the losses."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from train_cases import CHUNK, STAGE, TRAIN, clean, cube, sphere

from gcnd.errors import ConfigError, WeightsError
from gcnd.train.checkpoint import WeightAverage
from gcnd.train.loop import StepReport, TrainConfig, Trainer, batches, learning_rate
from gcnd.train.losses import chord_loss, mse_loss
from gcnd.train.samples import Batch, CleanShape, FreshNoise, make_chunk
from gcnd.weights.files import save_tensors


@pytest.fixture(scope="module")
def source() -> FreshNoise:
    return FreshNoise([clean(sphere()), clean(cube())])


def everything(trainer: Trainer) -> dict[str, Tensor]:
    state = {f"network.{name}": tensor for name, tensor in trainer.network.state_dict().items()}
    state |= {f"average.{name}": tensor for name, tensor in trainer.average.state.items()}
    for index, entries in trainer.optimizer.state_dict()["state"].items():
        state |= {f"optimizer.{index}.{name}": tensor for name, tensor in entries.items()}
    return {name: tensor.clone() for name, tensor in state.items()}


def test_a_resumed_run_is_the_same_to_the_bit(source: FreshNoise, tmp_path: Path) -> None:
    losses: list[float] = []
    straight = Trainer(TRAIN, source)
    start = everything(straight)
    straight.run(lambda report: losses.append(report.loss))

    resumed_losses: list[float] = []
    first = Trainer(TRAIN, source)
    first.run(lambda report: resumed_losses.append(report.loss), until=3)
    first.save(tmp_path / "half.safetensors", {"note": "kept"})
    torch.rand(7)  # the global generator of the process that goes on is somewhere else
    second = Trainer(replace(TRAIN, seed=TRAIN.seed), source)
    header = second.load(tmp_path / "half.safetensors")
    second.run(lambda report: resumed_losses.append(report.loss))

    assert header["note"] == "kept"
    assert (header["step"], first.step, second.step) == (3, 3, 6)
    assert resumed_losses == losses
    expected, found = everything(straight), everything(second)
    assert found.keys() == expected.keys()
    assert any(name.startswith("optimizer.0.") for name in found)
    assert all(torch.equal(found[name], tensor) for name, tensor in expected.items())
    changed = [name for name, tensor in start.items() if not torch.equal(expected[name], tensor)]
    assert len(changed) == len(start)


def test_reports_and_where_a_run_stops(source: FreshNoise) -> None:
    reports: list[StepReport] = []
    trainer = Trainer(TRAIN, source)
    trainer.run(reports.append, until=2)
    trainer.run(reports.append, until=2)
    assert [(r.step, r.steps) for r in reports] == [(1, 6), (2, 6)]
    assert all(r.patches_per_second > 0 for r in reports)
    last = reports[-1]
    assert last.seconds_left == pytest.approx(4 * 8 / last.patches_per_second)


def test_a_trainer_starts_from_the_weights_given(source: FreshNoise) -> None:
    other = Trainer(replace(TRAIN, seed=9), source).network.state_dict()
    trainer = Trainer(TRAIN, source, initial=other)
    assert all(torch.equal(tensor, other[name]) for name, tensor in trainer.network.state_dict().items())
    assert all(torch.equal(tensor, other[name]) for name, tensor in trainer.average.state.items())


def test_a_checkpoint_that_is_none_is_refused(source: FreshNoise, tmp_path: Path) -> None:
    (tmp_path / "bad.safetensors").write_bytes(b"\x80\x04 no tensors here")
    with pytest.raises(WeightsError, match=r"bad\.safetensors"):
        Trainer(TRAIN, source).load(tmp_path / "bad.safetensors")
    save_tensors(tmp_path / "bare.safetensors", {"x": torch.zeros(1)}, {"step": 1})
    with pytest.raises(ConfigError, match=r"bare\.safetensors was trained with other settings"):
        Trainer(TRAIN, source).load(tmp_path / "bare.safetensors")


def test_a_checkpoint_of_other_settings_is_refused(source: FreshNoise, tmp_path: Path) -> None:
    Trainer(TRAIN, source).save(tmp_path / "a.safetensors")
    assert Trainer(TRAIN, source).load(tmp_path / "a.safetensors")["step"] == 0
    with pytest.raises(ConfigError, match="other settings"):
        Trainer(replace(TRAIN, steps=7), source).load(tmp_path / "a.safetensors")


@pytest.mark.parametrize(("changed", "named"), [({"batch": 5}, "batch is 5"), ({"batch": 0}, "batch is 0")])
def test_a_batch_that_does_not_divide_a_chunk_is_refused(changed: dict[str, int], named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        replace(TRAIN, **changed)  # type: ignore[arg-type]


def test_meshes_that_do_not_divide_a_chunk_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"chunk\.n_meshes is 3"):
        replace(TRAIN, chunk=replace(CHUNK, n_meshes=3))


# --- batches -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("first_step", [0, 1, 3])
def test_batches_cut_the_chunks_in_order(source: FreshNoise, first_step: int) -> None:
    stream = batches(source, TRAIN, first_step)
    found = [next(stream) for _ in range(3)]
    stream.close()
    chunks = [make_chunk(source, STAGE.patch, CHUNK, TRAIN.seed, index) for index in range(3)]
    whole = Batch(*(torch.cat(parts) for parts in zip(*chunks, strict=True)))
    for number, batch in enumerate(found):
        rows = slice(8 * (first_step + number), 8 * (first_step + number + 1))
        assert all(torch.equal(a, b[rows]) for a, b in zip(batch, whole, strict=True))


class BrokenSource:
    def draw(self, rng: np.random.Generator) -> tuple[CleanShape, NDArray[np.float64]]:
        raise RuntimeError("shape file vanished")


def test_an_error_while_drawing_reaches_the_loop() -> None:
    with pytest.raises(RuntimeError, match="shape file vanished"):
        next(batches(BrokenSource(), TRAIN, 0))
    with pytest.raises(RuntimeError, match="shape file vanished"):
        Trainer(TRAIN, BrokenSource()).run(lambda report: None)


# --- learning rate and average -----------------------------------------------------------------------


def test_learning_rate_schedule() -> None:
    config = TrainConfig(STAGE, steps=1100, lr=2e-3, warmup=100, final_lr_ratio=0.01)
    expected = {
        0: 2e-5,
        49: 1e-3,
        99: 2e-3,
        100: 2e-3,
        350: 2e-3 * (0.01 + 0.99 * 0.5 * (1 + math.sqrt(0.5))),
        600: 2e-3 * 0.505,
        850: 2e-3 * (0.01 + 0.99 * 0.5 * (1 - math.sqrt(0.5))),
        1100: 2e-5,
        5000: 2e-5,
    }
    for step, rate in expected.items():
        assert learning_rate(config, step) == pytest.approx(rate, rel=1e-12), step
    assert learning_rate(replace(config, warmup=0), 0) == pytest.approx(2e-3)


def test_the_optimiser_gets_the_rate_of_its_step(source: FreshNoise) -> None:
    trainer = Trainer(TRAIN, source)
    rates = []
    trainer.run(lambda report: rates.append(trainer.optimizer.param_groups[0]["lr"]), until=4)
    assert rates == [learning_rate(TRAIN, step) for step in range(4)]


def test_weight_average_by_hand() -> None:
    network = nn.BatchNorm1d(1)
    average = WeightAverage(network, decay=0.5)
    network.weight.data.fill_(3.0)
    network.running_mean.fill_(8.0)
    network.num_batches_tracked.fill_(7)
    average.update(network, step=1)  # d = min(0.5, 2/11)
    assert average.state["weight"].item() == pytest.approx(1 + (9 / 11) * 2, rel=1e-6)
    assert average.state["running_mean"].item() == pytest.approx((9 / 11) * 8, rel=1e-6)
    assert average.state["num_batches_tracked"].item() == 7
    average.update(network, step=1000)  # d = 0.5
    assert average.state["weight"].item() == pytest.approx(3 - 0.5 * (4 / 11), rel=1e-6)
    network.weight.data.fill_(-1.0)
    assert average.state["weight"].item() > 2.5


def test_gradients_are_clipped_before_the_step(source: FreshNoise) -> None:
    trainer = Trainer(replace(TRAIN, grad_clip=1e-3), source)
    norms = []

    def record(report: StepReport) -> None:
        squares = [p.grad.square().sum() for p in trainer.network.parameters() if p.grad is not None]
        norms.append(math.sqrt(float(sum(squares))))

    trainer.run(record, until=2)
    assert norms == pytest.approx([1e-3, 1e-3], rel=1e-3)


# --- losses ------------------------------------------------------------------------------------------


def two_nodes() -> Batch:
    target = torch.tensor([[[1.0, 0, 0], [0, 1.0, 0]]])
    empty = torch.zeros(1, 2, 1)
    return Batch(empty, empty, target, torch.tensor([[1.0, 0.25]]))


def test_chord_loss_by_hand() -> None:
    # Chords of 90° and 180°: √2 and 2; lengths of the predictions do not count.
    predicted = torch.tensor([[[0.0, 5.0, 0.0], [0.0, -0.1, 0.0]]])
    expected = (math.sqrt(2) * 1.0 + 2 * 0.25) / 1.25
    assert chord_loss(predicted, two_nodes()).item() == pytest.approx(expected, rel=1e-6)
    assert chord_loss(predicted[:, 0], two_nodes()).item() == pytest.approx(math.sqrt(2), rel=1e-6)
    assert chord_loss(two_nodes().target, two_nodes()).item() == pytest.approx(1e-4, rel=1e-3)


def test_chord_loss_ignores_what_weighs_nothing_and_stays_finite() -> None:
    batch = two_nodes()._replace(weight=torch.zeros(1, 2))
    predicted = torch.zeros(1, 2, 3, requires_grad=True)
    loss = chord_loss(predicted, batch)
    loss.backward()
    assert loss.item() == 0.0
    assert torch.equal(predicted.grad, torch.zeros(1, 2, 3))
    exact = two_nodes().target.clone().requires_grad_()
    chord_loss(exact, two_nodes()).backward()
    assert torch.isfinite(exact.grad).all()


def test_mse_loss_is_of_the_centre_alone() -> None:
    predicted = torch.tensor([[[1.0, 1.0, 0.0], [9.0, 9.0, 9.0]]])
    assert mse_loss(predicted, two_nodes()).item() == pytest.approx(1 / 3)
    assert mse_loss(predicted[:, 0], two_nodes()).item() == pytest.approx(1 / 3)

"""Two processes give the gradients of one on the same data, and train to weights together."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import torch
from distributed_cases import one_step
from safetensors.torch import load_file, save_file
from test_corpus import write_dataset
from train_cases import CHUNK, STAGE, TRAIN, clean, cube, sphere

from gcnd.errors import ConfigError
from gcnd.nn import distributed
from gcnd.nn.distributed import mean_over_processes, n_processes, process_group, process_rank
from gcnd.train import loop
from gcnd.train.loop import Trainer
from gcnd.train.recipes import get_recipe
from gcnd.train.samples import Batch, FreshNoise, make_chunk
from gcnd.weights import load_cascade

HERE = Path(__file__).parent


def torchrun(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [
        sys.executable,
        "-m",
        "torch.distributed.run",
        "--standalone",
        "--nproc-per-node",
        "2",
        *arguments,
    ]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=300)


@pytest.mark.parametrize("name", ["nodes", "paper"])
def test_gradients_equal_those_of_one_process(tmp_path: Path, name: str) -> None:
    source = FreshNoise([clean(sphere()), clean(cube())])
    batch = make_chunk(source, STAGE.patch, CHUNK, seed=3, index=0)
    # Uneven weights in the halves: each half's own mean would not do.
    batch.weight[::2] *= 0.25
    save_file(dict(zip(Batch._fields, batch, strict=True)), tmp_path / "batch.safetensors")
    done = torchrun(str(HERE / "distributed_cases.py"), str(tmp_path), name, cwd=HERE)
    assert done.returncode == 0, done.stderr
    alone = one_step(name, batch)
    for rank in range(2):
        together = load_file(tmp_path / f"{name}.{rank}.safetensors")
        assert together.keys() == alone.keys()
        assert sum(float(value.abs().max()) > 1e-6 for value in alone.values()) > 20
        for key, expected in alone.items():
            scale = float(expected.abs().max()) + 1e-12
            assert float((together[key] - expected).abs().max()) < 2e-4 * scale, key


def test_two_processes_go_on_to_the_same_bits(tmp_path: Path) -> None:
    done = torchrun(str(HERE / "distributed_cases.py"), str(tmp_path), "resume", cwd=HERE)
    assert done.returncode == 0, done.stderr
    assert [(tmp_path / f"resume.{rank}").read_text(encoding="utf-8") for rank in range(2)] == [
        "True",
        "True",
    ]


def test_processes_that_see_different_folders_are_told(tmp_path: Path) -> None:
    done = torchrun(str(HERE / "distributed_cases.py"), str(tmp_path), "folders", cwd=HERE)
    assert done.returncode == 0, done.stderr
    told = [(tmp_path / f"folders.{rank}").read_text(encoding="utf-8") for rank in range(2)]
    assert told == ["one folder: ok; own folders: 1 of 2 see another"] * 2
    assert list((tmp_path / "shared").iterdir()) == []


def test_two_processes_train_a_cascade(tmp_path: Path) -> None:
    write_dataset(tmp_path / "data")
    arguments = ["-m", "gcnd.train", "--pairs", str(tmp_path / "data"), "--scale", "1e-9"]
    arguments += ["--out", str(tmp_path / "run"), "--precision", "float32"]
    done = torchrun(*arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [str(tmp_path / "run" / "default.safetensors")]
    cascade = load_cascade(done.stdout.strip())
    assert cascade.config.stages == tuple(s.stage for s in get_recipe("default").stages)
    log = (tmp_path / "run" / "log.jsonl").read_text(encoding="utf-8").splitlines()
    assert len(log) == len(cascade.config.stages)


def test_a_batch_that_cannot_be_shared_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop, "n_processes", lambda: 3)
    with pytest.raises(ConfigError, match="a batch of 8 cannot be shared evenly by 3 processes"):
        Trainer(TRAIN, FreshNoise([clean(sphere())]))


def test_one_process_is_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("WORLD_SIZE", raising=False)
    with process_group(torch.device("cpu")) as device:
        assert device == torch.device("cpu")
        assert (n_processes(), process_rank()) == (1, 0)
        x = torch.tensor([1.0, 2.0])
        assert mean_over_processes(x) is x
        with distributed.first_process_first():
            pass


def test_half_of_torchruns_environment_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WORLD_SIZE", "2")
    monkeypatch.delenv("RANK", raising=False)
    with (
        pytest.raises(ConfigError, match="WORLD_SIZE is set, but not RANK"),
        process_group(torch.device("cpu")),
    ):
        pass


def test_a_process_without_a_gpu_of_its_own_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"WORLD_SIZE": "3", "RANK": "2", "LOCAL_RANK": "2"}.items():
        monkeypatch.setenv(name, value)
    for name in ("MASTER_ADDR", "MASTER_PORT"):
        monkeypatch.setenv(name, "0")
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    with (
        pytest.raises(ConfigError, match="process 2 of this machine has no CUDA device"),
        process_group(torch.device("cuda")),
    ):
        pass

"""The page about a training run: what the log says, in order, and pictures of the examples."""

from __future__ import annotations

import base64
import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from train_cases import sphere

from gcnd.cli.app import main
from gcnd.data.noise import add_noise
from gcnd.errors import ConfigError
from gcnd.train.report import read_log, write_report


def line(stage: int, step: int, loss: float, error: float | None = None) -> str:
    values = {"time": 1.0, "stage": stage, "step": step, "loss": loss, "patches_per_second": 1000.0}
    return json.dumps(values if error is None else {**values, "validation_e_a": error})


@pytest.fixture
def run(tmp_path: Path) -> Path:
    folder = tmp_path / "a run"
    folder.mkdir()
    lines = [line(1, 100, 0.3), line(1, 200, 0.2, 4.25), line(2, 100, 0.15), line(2, 200, 0.125, 3.5)]
    (folder / "log.jsonl").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def test_the_log_is_read_in_order_and_repeats_count_once(run: Path) -> None:
    with (run / "log.jsonl").open("a", encoding="utf-8") as file:
        file.write(line(1, 100, 0.25) + "\n" + '{"stage": 2, "st')
    lines = read_log(run)
    assert [(one["stage"], one["step"], one["loss"]) for one in lines] == [
        (1, 100, 0.25),
        (1, 200, 0.2),
        (2, 100, 0.15),
        (2, 200, 0.125),
    ]


def test_a_damaged_line_in_the_middle_is_named(run: Path) -> None:
    with (run / "log.jsonl").open("a", encoding="utf-8") as file:
        file.write("{half\n" + line(2, 300, 0.1) + "\n")
    with pytest.raises(ConfigError, match=r"line 5 of .* is damaged"):
        read_log(run)


def test_the_page_shows_figures_curves_and_pictures_without_a_network(run: Path) -> None:
    shape = sphere()
    noisy = add_noise(shape.vertices, shape.faces, level=0.2, seed=1)
    meshes = {"noisy": noisy, "denoised": 0.5 * (noisy + shape.vertices), "clean": shape.vertices}
    np.savez(run / "example-1.npz", name="a <sphere>", faces=shape.faces, **meshes)
    write_report(run, run / "page.html")
    page = (run / "page.html").read_text(encoding="utf-8")
    assert "<h1>Training run a run</h1>" in page
    assert "<td>200<td>0.2000<td>4.25°<td>1,000" in page
    assert "<td>200<td>0.1250<td>3.50°<td>1,000" in page
    assert page.count("<svg") == 1
    assert "a &lt;sphere&gt;" in page
    pictures = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    assert [base64.b64decode(text)[:4] for text in pictures] == [b"\x89PNG"]
    assert not re.search(r'(?:src|href)="?https?:', page)
    assert sorted(path.name for path in run.iterdir()) == ["example-1.npz", "log.jsonl", "page.html"]


def test_the_command_writes_where_it_is_told(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train-report", str(run)]) == 0
    assert capsys.readouterr().out.strip() == str(run / "report.html")
    assert (run / "report.html").stat().st_size > 10_000
    assert main(["train-report", str(run / "nowhere")]) == 1
    assert "no training run in" in capsys.readouterr().err
    (run / "log.jsonl").write_text("", encoding="utf-8")
    assert main(["train-report", str(run)]) == 1
    assert "holds no line yet" in capsys.readouterr().err


@pytest.mark.parametrize("left", [0, 500])
def test_a_damaged_example_is_named(run: Path, capsys: pytest.CaptureFixture[str], left: int) -> None:
    example = run / "example-1.npz"
    np.savez(example, name="sphere", faces=np.zeros((100, 3)))
    example.write_bytes(example.read_bytes()[:left])
    assert main(["train-report", str(run)]) == 1
    told = capsys.readouterr().err
    assert "example-1.npz is damaged" in told
    assert "gcnd train writes it again" in told
    assert not (run / "report.html").exists()


@pytest.mark.parametrize("name", ["log.jsonl", "link.html", "stage1.pool/0.npz"])
def test_a_page_replaces_nothing_of_the_run(run: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    (run / "stage1.pool").mkdir()
    (run / "stage1.pool" / "0.npz").write_bytes(b"a mesh")
    os.link(run / "log.jsonl", run / "link.html")
    before = (run / name).read_bytes()
    assert main(["train-report", str(run), "--out", str(run / name)]) == 1
    assert "another file of this run" in capsys.readouterr().err
    assert (run / name).read_bytes() == before

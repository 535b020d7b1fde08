"""Many meshes: what is skipped, what fails, what is written, and how it is stopped."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from gcnd import Controls, denoise_many
from gcnd.cli import main
from gcnd.data.noise import add_noise
from gcnd.errors import Cancelled, ConfigError, MeshError
from gcnd.filters import Filter, apply_filter
from gcnd.many import mesh_files
from gcnd.mesh_io import load, save

BALL = trimesh.creation.icosphere(subdivisions=2)
TAUBIN = Filter("taubin")


def noisy(seed: int) -> tuple[np.ndarray, np.ndarray]:
    faces = BALL.faces.astype(np.uint32)
    return add_noise(np.array(BALL.vertices), faces, level=0.2, seed=seed), faces


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three meshes, one broken file between them, and what is no mesh."""
    folder = tmp_path / "in"
    (folder / "deep").mkdir(parents=True)
    save(noisy(1), folder / "a.ply")
    (folder / "b.ply").write_bytes(b"ply\nformat ascii 1.0\n")
    save(noisy(2), folder / "deep" / "c.off")
    save(noisy(3), folder / "z.OBJ")
    (folder / "notes.txt").write_text("not a mesh")
    (folder / ".hidden.ply").write_text("not a mesh")
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def statuses(outcomes: Any) -> dict[str, str]:
    return {outcome.name: outcome.status for outcome in outcomes}


ALL = {"a.ply": "done", "b.ply": "failed", "deep/c.off": "done", "z.OBJ": "done"}


def test_a_bad_file_does_not_stop_the_others(folder: Path, tmp_path: Path) -> None:
    before, out = contents(folder), tmp_path / "out"
    outcomes = denoise_many(folder, out, denoiser=TAUBIN)
    assert statuses(outcomes) == ALL
    assert set(contents(out)) == {"a.ply", "deep/c.off", "z.OBJ"}
    assert contents(folder) == before
    for outcome in outcomes:
        assert outcome.denoised is None
        if outcome.status == "done":
            assert outcome.error is None
            expected = apply_filter(folder / outcome.name, "taubin").vertices
            assert np.abs(load(out / outcome.name).vertices - expected).max() < 1e-6
        else:
            assert isinstance(outcome.error, MeshError)
            assert str(folder / "b.ply") in str(outcome.error)


def test_what_is_done_is_skipped_unless_older_or_told(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    denoise_many(folder, out, denoiser=TAUBIN)
    written = {path: path.stat().st_mtime_ns for path in out.rglob("*") if path.is_file()}
    again = denoise_many(folder, out, denoiser=TAUBIN)
    assert statuses(again) == {name: "skipped" if s == "done" else s for name, s in ALL.items()}
    assert [outcome.output for outcome in again if outcome.status == "skipped"] == sorted(written)
    assert {path: path.stat().st_mtime_ns for path in written} == written
    os.utime(folder / "a.ply", ns=(written[out / "a.ply"] + 1,) * 2)
    assert statuses(denoise_many(folder, out, denoiser=TAUBIN)) == statuses(again) | {"a.ply": "done"}
    assert statuses(denoise_many(folder, out, denoiser=TAUBIN, overwrite=True)) == ALL


def test_results_inside_the_input_are_no_input(folder: Path) -> None:
    for _ in range(2):
        outcomes = denoise_many(folder, folder / "clean", denoiser=TAUBIN, overwrite=True)
        assert statuses(outcomes) == ALL
    assert len(mesh_files(folder)) == 4 + 3
    assert len(mesh_files(folder, folder / "clean")) == 4


@pytest.mark.skipif(os.name == "nt", reason="links need a right there")
def test_links_that_lead_to_themselves_are_no_meshes(folder: Path, tmp_path: Path) -> None:
    (folder / "loop").symlink_to("loop")
    (folder / "loop.ply").symlink_to("loop.ply")
    assert statuses(denoise_many(folder, tmp_path / "out", denoiser=TAUBIN)) == ALL


def test_results_may_go_above_the_input(folder: Path) -> None:
    before = contents(folder)
    assert statuses(denoise_many(folder, folder.parent, denoiser=TAUBIN)) == ALL
    assert contents(folder) == before
    assert {"a.ply", "deep/c.off", "z.OBJ"} < set(contents(folder.parent))


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("how", ["nested", "link"])
def test_a_result_never_replaces_another_input(folder: Path, how: str, overwrite: bool) -> None:
    out = folder.parent
    if how == "nested":  # in/in/a.ply would become in/a.ply, which is read too
        (folder / "in").mkdir()
        save(noisy(4), folder / "in" / "a.ply")
    else:
        out = folder.parent / "out"
        out.mkdir()
        (out / "a.ply").symlink_to(folder / "z.OBJ")
    before = contents(folder.parent)
    with pytest.raises(ConfigError, match="goes, is the input"):
        denoise_many(folder, out, denoiser=TAUBIN, overwrite=overwrite)
    assert contents(folder.parent) == before


def test_progress_is_one_for_all_and_goes_by_size(folder: Path, tmp_path: Path) -> None:
    told: list[tuple[float, str]] = []
    denoise_many(folder, tmp_path / "out", denoiser=TAUBIN, progress=lambda *call: told.append(call))
    fractions = [fraction for fraction, _ in told]
    assert fractions == sorted(fractions)
    assert told[-1] == (1.0, "done")
    names = ["a.ply (1 of 4)", "deep/c.off (3 of 4)", "z.OBJ (4 of 4)"]
    assert list(dict.fromkeys(label for _, label in told)) == [*names, "done"]
    sizes = [(folder / name).stat().st_size for name in ALL]
    first = max(fraction for fraction, label in told if label == names[0])
    assert first == pytest.approx(sizes[0] / sum(sizes))


def test_cancelling_keeps_what_is_done_and_leaves_nothing_half(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(Cancelled):
        denoise_many(folder, out, denoiser=TAUBIN, progress=lambda _, label: not label.startswith("z"))
    assert set(contents(out)) == {"a.ply", "deep/c.off"}
    assert statuses(denoise_many(folder, out, denoiser=TAUBIN)) == {
        "a.ply": "skipped", "b.ply": "failed", "deep/c.off": "skipped", "z.OBJ": "done",
    }  # fmt: skip


def test_a_mesh_that_fails_in_any_way_is_told(tmp_path: Path) -> None:
    class Broken:
        triangulate = False

        def run(self, mesh: Any, *, progress: Any = None) -> Any:
            raise RuntimeError("no memory left for this") if len(mesh.faces) > 1 else KeyboardInterrupt

    save(noisy(1), tmp_path / "a.ply")
    (outcome,) = denoise_many([tmp_path / "a.ply"], tmp_path / "out", denoiser=Broken())
    assert (outcome.status, type(outcome.error)) == ("failed", RuntimeError)
    save((np.eye(3), [[0, 1, 2]]), tmp_path / "a.ply")
    with pytest.raises(KeyboardInterrupt):
        denoise_many([tmp_path / "a.ply"], tmp_path / "out", denoiser=Broken())


def test_meshes_come_back_in_order(folder: Path) -> None:
    meshes = [noisy(5), folder / "a.ply", (np.full((3, 3), np.nan), [[0, 1, 2]])]
    outcomes = denoise_many(iter(meshes), denoiser=TAUBIN, reports=True)
    assert [outcome.name for outcome in outcomes] == ["mesh 0", str(folder / "a.ply"), "mesh 2"]
    assert [outcome.status for outcome in outcomes] == ["done", "done", "failed"]
    assert outcomes[0].denoised is not None
    assert outcomes[0].report is not None
    assert np.array_equal(outcomes[0].denoised.mesh[0], apply_filter(noisy(5), "taubin")[0])
    assert outcomes[0].report["method"]["filter"] == "taubin"


@pytest.mark.parametrize(
    ("meshes", "output", "error", "message"),
    [
        ("in", None, ConfigError, "a folder of meshes needs a folder for the results"),
        ("absent", "out", ConfigError, "no such folder"),
        ("in", "in", ConfigError, "is the input itself"),
        ("in/empty", "out", ConfigError, "there is no mesh to denoise"),
        (
            ["in/a.ply", "in/deep/c.off"],
            "in",
            ConfigError,
            r"in/a\.ply, where .* goes, is the input in/a\.ply",
        ),
        (["in/a.ply", "in/empty/../a.ply"], "out", ConfigError, "two results would be written to a.ply"),
        ([noisy(1)], "out", ConfigError, "mesh 0 is no file: its result has no name"),
        ([], None, ConfigError, "there is no mesh to denoise"),
    ],
)
def test_what_cannot_be_started(
    folder: Path, monkeypatch: pytest.MonkeyPatch, meshes: Any, output: Any, error: Any, message: str
) -> None:
    (folder / "empty").mkdir()
    monkeypatch.chdir(folder.parent)
    before = contents(folder.parent)
    with pytest.raises(error, match=message):
        denoise_many(meshes, output, denoiser=TAUBIN)
    assert contents(folder.parent) == before


# --- the command line --------------------------------------------------------------------------------


def run_folder(folder: Path, *options: str) -> int:
    return main(["denoise", str(folder), str(folder.parent / "out"), "--method", "taubin", *options])


def test_a_folder_ends_with_a_table_and_1_if_one_failed(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_folder(folder) == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    table = printed.err.splitlines()[-5:]
    assert [line.split()[0] for line in table[:-1]] == ["done", "failed", "done", "done"]
    assert [line.split()[3].rstrip(":") for line in table[:-1]] == list(ALL)
    assert "cannot read" in table[1]
    assert table[-1] == "3 done, 0 skipped, 1 failed"
    assert run_folder(folder, "-q") == 1
    (failed, hint, counts) = capsys.readouterr().err.splitlines()
    assert failed.startswith("failed ")
    assert "--overwrite" in hint
    assert counts == "0 done, 3 skipped, 1 failed"
    (folder / "b.ply").unlink()
    assert run_folder(folder, "-q") == 0
    assert capsys.readouterr() == ("", "")


def test_a_folder_as_json_with_a_report_and_controls(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = folder.parent / "report.json"
    assert run_folder(folder, "--json", "-q", "--report", str(report), "--strength", "0") == 1
    shown = json.loads(capsys.readouterr().out)
    assert {row["name"]: row["status"] for row in shown["files"]} == ALL
    assert shown["settings"]["method"] == "taubin"
    rows = {row["name"]: row for row in json.loads(report.read_text())}
    assert rows["b.ply"]["report"] is None
    assert "b.ply" in rows["b.ply"]["error"]
    assert rows["a.ply"]["report"]["displacement"]["max"] == 0.0
    assert rows["a.ply"]["report"]["method"]["controls"]["strength"] == 0.0
    assert np.array_equal(load(folder.parent / "out" / "a.ply").vertices, load(folder / "a.ply").vertices)


def test_a_second_run_keeps_the_reports_of_what_it_skips(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = folder.parent / "out" / "report.json"
    assert run_folder(folder, "-q", "--report", str(report)) == 1
    first = {row["name"]: row["report"] for row in json.loads(report.read_text())}
    (folder.parent / "out" / "a.ply").unlink()
    assert run_folder(folder, "-q", "--report", str(report)) == 1
    second = {row["name"]: (row["status"], row["report"]) for row in json.loads(report.read_text())}
    assert {status for status, _ in second.values()} == {"done", "skipped", "failed"}
    for name, (status, found) in second.items():
        assert found == first[name] if status == "skipped" else (found is None) == (status == "failed")
    report.write_text("no report")
    assert run_folder(folder, "-q", "--report", str(report)) == 1
    assert {row["report"] for row in json.loads(report.read_text())} == {None}
    capsys.readouterr()


@pytest.mark.parametrize("name", ["in/a.ply", "in/deep/c.off", "out/z.OBJ"])
def test_a_report_of_a_folder_replaces_no_mesh(
    folder: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    (folder.parent / "out").mkdir()
    before = contents(folder.parent)
    assert run_folder(folder, "--report", str(folder.parent / name)) == 1
    assert "is the input itself, or another file of this run" in capsys.readouterr().err
    assert contents(folder.parent) == before


def test_a_folder_that_is_not_there_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["denoise", str(tmp_path / "absent"), str(tmp_path / "out")]) == 1
    told = capsys.readouterr().err
    assert told.startswith(f"error: no such file or folder: {tmp_path / 'absent'}\n\nhint: ")
    assert not list(tmp_path.iterdir())


def test_a_folder_is_not_written_to_a_file(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = folder.parent / "out"
    out.write_text("precious")
    assert run_folder(folder) == 1
    assert "is a file, and" in capsys.readouterr().err
    assert out.read_text() == "precious"


def test_controls_reach_every_mesh(folder: Path, tmp_path: Path) -> None:
    denoise_many(
        folder, tmp_path / "out", denoiser=Filter("taubin", controls=Controls(max_displacement=1e-3))
    )
    for name in ("a.ply", "deep/c.off", "z.OBJ"):
        ways = np.linalg.norm(load(tmp_path / "out" / name).vertices - load(folder / name).vertices, axis=1)
        assert 0.999e-3 < ways.max() <= 1e-3

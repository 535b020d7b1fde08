"""What is denoised: generated shapes, clean folders and pairs, the same arrays at each call."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from compare_cases import ball, write_meshes
from gcnd.compare.cases import FIRST_SHAPE_SEED, Case, NoisePlan, collect_cases
from gcnd.data import generated
from gcnd.data.noise import add_noise
from gcnd.data.shapes import Shape
from gcnd.errors import ConfigError, GcndError, MeshError
from gcnd.mesh_io import save
from gcnd.scans import simulate


def collect(dataset: Path | str, plan: NoisePlan | None = None, **options: object) -> list[Case]:
    folder = Path("unused")
    return collect_cases(str(dataset), plan or NoisePlan(), shape_folder=folder, **options)  # type: ignore[arg-type]


def test_a_clean_folder_gets_every_kind_at_every_level(tmp_path: Path) -> None:
    write_meshes(tmp_path, "cad/a.ply", "b.off", "b.obj")
    cases = collect(tmp_path, NoisePlan(("gaussian", "isotropic"), (0.1, 0.25), seed=5))
    names = [("b.obj", "mesh"), ("b.off", "mesh"), ("cad/a", "cad")]
    expected = [
        (name, kind, noise, level)
        for name, kind in names
        for noise in ("gaussian", "isotropic")
        for level in ("0.1", "0.25")
    ]
    assert [(case.mesh, case.kind, case.noise, case.level) for case in cases] == expected
    last = cases[-1].load()
    noisy = add_noise(last.truth, last.faces, kind="isotropic", level=0.25, seed=5)
    assert np.array_equal(last.noisy, noisy)
    assert last.digest == cases[-1].load().digest
    assert len({case.load().digest for case in cases[:4]}) == 4


def test_names_that_stand_for_means_are_put_in_quotes(tmp_path: Path) -> None:
    write_meshes(tmp_path / "clean", "all/a.ply")
    assert {case.kind for case in collect(tmp_path / "clean")} == {"'all'"}
    noisy = write_pairs(tmp_path / "pairs" / "test") / "noisy"
    (noisy / "ball_n2.ply").rename(noisy / "ball_all.ply")
    assert {case.level for case in collect(tmp_path / "pairs")} == {"'all'", "n1"}


def test_a_scan_is_one_case_whatever_the_levels_and_has_faces_of_its_own(tmp_path: Path) -> None:
    write_meshes(tmp_path, "a.ply")
    cases = collect(tmp_path, NoisePlan(("kinect2", "print", "gaussian"), (0.1, 0.2), seed=3))
    assert [(case.noise, case.level) for case in cases] == [
        ("kinect2", "scan"),
        ("print", "scan"),
        ("gaussian", "0.1"),
        ("gaussian", "0.2"),
    ]
    frame, printed, clean = (case.load() for case in cases[:3])
    mesh = ball()
    pair = simulate("kinect2", clean.truth, mesh.faces, seed=3)
    assert np.array_equal(frame.noisy, pair.noisy_vertices)
    assert np.array_equal(frame.truth, pair.clean_vertices)
    assert np.array_equal(frame.faces, pair.faces)
    assert np.array_equal(printed.faces, mesh.faces), "a print keeps the mesh's faces"
    assert frame.digest == cases[0].load().digest


def write_pairs(folder: Path) -> Path:
    mesh = ball()
    for part, name, vertices in (
        ("noisy", "ball_n1.ply", mesh.noisy),
        ("noisy", "ball_n2.ply", mesh.noisy + 0.01),
        ("original", "ball.ply", mesh.truth),
    ):
        (folder / part).mkdir(parents=True, exist_ok=True)
        save((vertices, mesh.faces), folder / part / name)
    return folder


def test_pairs_are_found_with_and_without_halves(tmp_path: Path) -> None:
    half = write_pairs(tmp_path / "data" / "test")
    for dataset in (tmp_path / "data", half):
        cases = collect(dataset)
        assert [(c.mesh, c.noise, c.level) for c in cases] == [
            ("ball", "given", "n1"),
            ("ball", "given", "n2"),
        ]
        assert np.allclose(cases[1].load().noisy, cases[0].load().noisy + 0.01)
        assert np.allclose(cases[0].load().truth, ball().truth)
    with pytest.raises(ConfigError, match="no such folder"):
        collect(tmp_path / "data", split="train")


def test_a_pair_that_does_not_fit_is_told_before_anything_runs(tmp_path: Path) -> None:
    folder = write_pairs(tmp_path / "test")
    mesh = ball()
    save((mesh.truth, mesh.faces[:-1]), folder / "original" / "ball.ply")
    with pytest.raises(MeshError, match=r"has 320 faces, its truth .* has 319") as caught:
        collect(tmp_path)
    assert caught.value.hint == "both need the same faces in the same order"
    shutil.rmtree(folder / "original")
    (folder / "original").mkdir()
    with pytest.raises(ConfigError, match="no mesh in"):
        collect(tmp_path)


def test_builtin_takes_shapes_that_were_never_trained_on(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    mesh = ball()
    calls = []

    def load_shapes(
        n: int, seed: int, folder: Path, *, kinds: Mapping[str, float], **_: object
    ) -> list[Shape]:
        assert set(kinds) == {"cad", "smooth", "feature"}
        calls.append((n, seed, folder))
        return [Shape("cad-1", "cad", mesh.truth, mesh.faces)] * n

    monkeypatch.setattr("gcnd.data.shape_cache.load_shapes", load_shapes)
    cases = collect_cases("builtin", NoisePlan(levels=(0.2,), seed=1), n_shapes=1, shape_folder=tmp_path)
    assert calls == [(1, FIRST_SHAPE_SEED, tmp_path)]
    assert (cases[0].mesh, cases[0].kind) == ("cad-1", "cad")
    assert np.array_equal(cases[0].load().noisy, mesh.noisy)
    monkeypatch.setitem(sys.modules, "gcnd.data.shape_cache", None)
    with pytest.raises(GcndError, match="procedural shapes need") as caught:
        generated.load_generated(1, 0, tmp_path, hint="do this")
    assert caught.value.hint == "do this"


def test_folders_without_a_mesh_are_told(tmp_path: Path) -> None:
    for dataset, message in (
        (tmp_path / "nowhere", "no such folder"),
        (tmp_path, "no mesh in"),
        (tmp_path / "file", "is a file, not a folder"),
    ):
        if dataset.name == "file":
            dataset.write_text("")
        with pytest.raises(ConfigError, match=message) as caught:
            collect(dataset)
        assert caught.value.hint
    with pytest.raises(ConfigError, match="number of shapes is 0"):
        collect("builtin", n_shapes=0)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"kinds": ("salt",)}, "unknown noise 'salt'"),
        ({"kinds": ()}, "no noise is named"),
        ({"levels": (0.1, -0.2)}, "noise level is -0.2, allowed: 0 to 10"),
        ({"levels": (float("nan"),)}, "noise level is nan"),
        ({"levels": ()}, "no noise level is given"),
        ({"fraction": 1.5}, "fraction is 1.5, allowed: 0 to 1"),
    ],
)
def test_noise_out_of_range_is_told(values: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        NoisePlan(**values)  # type: ignore[arg-type]

"""Names of methods: settings, groups, what is unknown, and what is not installed."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

import pytest

from gcnd.auto import CANDIDATES
from gcnd.compare import methods as registry
from gcnd.compare.adapters import LIBRARIES, Adapted, Library
from gcnd.compare.methods import available, classical_labels, known_names, parse_methods
from gcnd.compare.own import PRESET_SETTINGS, filtered
from gcnd.errors import ConfigError, WeightsError
from gcnd.filters import list_filters
from gcnd.weights.registry import find_weights


def labels(*texts: str) -> list[str]:
    return [method.label for method in parse_methods(texts)]


def test_settings_in_brackets_reach_the_method() -> None:
    (method,) = parse_methods(["guided-normal[ sigma_r=0.2, normal_iterations=10 ]"])
    assert method.label == "guided-normal[sigma_r=0.2,normal_iterations=10]"
    assert (method.family, method.source) == ("guided-normal", "gcnd")
    assert method.settings["method"] == "guided-normal"
    assert (method.settings["sigma_r"], method.settings["normal_iterations"]) == (0.2, 10)
    assert method.settings["vertex_iterations"] == 20  # the rest are the defaults, and written down
    (other,) = parse_methods(["trimesh:taubin[iterations=3]"])
    assert other.settings == {"lamb": 0.5, "nu": 0.5, "iterations": 3}
    assert (other.family, other.source) == ("trimesh:taubin", "trimesh")


def test_the_same_run_is_not_run_twice() -> None:
    assert labels("l0,l0", "l0") == ["l0"]
    # 0.35 is the default of sigma_r.
    assert labels("guided-normal,guided-normal[sigma_r=0.35]") == ["guided-normal"]
    assert labels("taubin,trimesh:taubin") == ["taubin", "trimesh:taubin"]


def test_classical_is_every_filter_with_the_best_of_sigma_r_and_trimeshs_smoothers() -> None:
    found = labels("classical")
    for info in list_filters():
        if "sigma_r" in info.parameters:
            assert [f"{info.name}[sigma_r={value}]" in found for value in (0.2, 0.35, 0.45)] == [True] * 3
        else:
            assert info.name in found
    assert {"trimesh:humphrey", "trimesh:humphrey-tuned", "trimesh:taubin", "trimesh:taubin-tuned"} <= {
        *found
    }
    assert not any(name.startswith("pymeshlab") for name in found)
    named = parse_methods(["guided-normal,trimesh:laplacian,l0,pymeshlab:two-step"])
    assert classical_labels(named) == ["guided-normal", "l0"]


def test_groups_and_libraries_stand_for_their_methods() -> None:
    assert labels("open3d") == [f"open3d:{name}" for name in LIBRARIES["open3d"].methods]
    assert {*labels("libraries")} == {
        f"{library}:{name}" for library, found in LIBRARIES.items() for name in found.methods
    }
    assert {*labels("presets")} >= {"default", "fast"}
    assert {*labels("all")} >= {*labels("presets"), *labels("classical"), *labels("libraries")}
    assert {"classical", "guided-normal", "pymeshlab:two-step-tuned", "default"} <= {*known_names()}


def test_every_tuned_setting_has_its_documented_default_beside_it() -> None:
    for library in LIBRARIES.values():
        for name, adapted in library.methods.items():
            if name.endswith("-tuned"):
                default = library.methods[name.removesuffix("-tuned")]
                assert default.make is adapted.make
                assert default.settings.keys() == adapted.settings.keys()
                assert default.settings != adapted.settings


def test_weights_count_into_the_version(tmp_path: Path) -> None:
    path = tmp_path / "mine.safetensors"
    shutil.copyfile(find_weights("fast"), path)
    (method,) = parse_methods([f"{path}[seed=3]"])
    assert method.version.endswith(hashlib.sha256(path.read_bytes()).hexdigest()[:12])
    assert method.settings == {"preset": str(path), **PRESET_SETTINGS, "seed": 3}
    assert parse_methods(["default"])[0].version != parse_methods(["fast"])[0].version


def test_auto_is_a_method_of_its_own_with_the_weights_of_all_candidates() -> None:
    (auto,) = parse_methods(["auto"])
    for candidate in CANDIDATES:
        (method,) = parse_methods([candidate])
        assert method.version.split()[-1] in auto.version
    assert "auto" not in labels("presets")


@pytest.mark.parametrize(
    ("text", "message", "hint"),
    [
        ("l1", "there is no method 'l1'", "guided-normal"),
        ("pymeshlab:l1", "there is no method 'pymeshlab:l1'", "pymeshlab:two-step-tuned"),
        ("vtk:taubin", "there is no method 'vtk:taubin'", "pyvista:taubin"),
        ("nowhere/a.safetensors", "no such weights file: nowhere/a.safetensors", "default"),
        ("l0[alpha]", "l0 is given 'alpha', allowed: NAME=VALUE", None),
        ("guided-normal[sigma=1]", "guided-normal has no parameter 'sigma'", "sigma_r"),
        ("guided-normal[sigma_r=x]", "sigma_r is x, allowed: a number", None),
        ("default[patch=1]", "default has no setting 'patch'", "normal_iterations"),
        ("default[seed=-1]", "default: seed is -1, allowed: 0 or more", None),
        ("default[seed=x]", "default: seed is x, allowed: a whole number, 0 or more", None),
        (f"fast[seed={2**64}]", f"fast: seed is {2**64}, allowed: below 2**64", None),
        ("fast[vertex_iterations=10001]", "fast: vertex_iterations is 10001, allowed: 0 to 10000", None),
        ("taubin[lambda=2]", "taubin: lambda is 2, allowed: above 0 and at most 1", None),
        (f"taubin[iterations={2**64}]", f"taubin: iterations is {2**64}, allowed: below 2**64", None),
        (f"trimesh:taubin[iterations={10**309}]", f"iterations is {10**309}, allowed: a whole number", None),
        ("trimesh:taubin[mu=1]", "trimesh:taubin has no setting 'mu'", "lamb, nu, iterations"),
        ("trimesh:taubin[iterations=1.5]", "iterations is 1.5, allowed: a whole number", None),
        ("pyvista:taubin[boundary_smoothing=2]", "boundary_smoothing is 2, allowed: true or false", None),
        ("classical[sigma_r=1]", "classical is a group and takes no settings", "one by one"),
        ("l0]", "cannot read the method 'l0]'", "name[setting=value"),
        (" , ", "no method is named", "classical"),
    ],
)
def test_what_cannot_be_read_is_told(text: str, message: str, hint: str | None) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_methods([text])
    assert str(caught.value) == message
    assert (hint is None and caught.value.hint is None) or hint in (caught.value.hint or "")


def test_a_missing_library_is_left_out_with_a_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "broken_library.py").write_text("raise ImportError('libmissing.so: not there')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.syspath_prepend(str(tmp_path))
    for number, (name, hint) in enumerate(
        (("no_such_library", None), ("broken_library", "install libmissing"))
    ):
        methods = {key: Adapted(filtered, {key: number}) for key in "ab"}
        monkeypatch.setitem(registry.LIBRARIES, name, Library(name, name, methods, hint))
    found, lines = available(parse_methods(["no_such_library,l0,broken_library:b,trimesh:taubin"]))
    assert [method.label for method in found] == ["l0", "trimesh:taubin"]
    assert lines == [
        "skipped no_such_library:a, no_such_library:b: no_such_library is not installed "
        "(pip install 'gcnd[compare]')",
        "skipped broken_library:b: broken_library cannot be imported: "
        "ImportError: libmissing.so: not there; install libmissing",
    ]


@pytest.mark.parametrize("text", ["tgv[alpha1=1e16]", "l0[alpha=1e15]"])
def test_a_method_that_diverges_where_it_is_tried_is_not_refused(text: str) -> None:
    assert labels(f"{text},taubin") == [text, "taubin"]


def test_weights_that_cannot_be_read_are_told_at_once(tmp_path: Path) -> None:
    path = tmp_path / "junk.safetensors"
    path.write_bytes(b"no weights")
    with pytest.raises(WeightsError, match=r"cannot read .*junk\.safetensors") as caught:
        parse_methods([str(path)])
    assert caught.value.hint == "the file is not a weights file, or it is cut short"

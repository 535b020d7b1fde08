"""The licence texts of linked crates: which crates they are of, and that the file at hand names those of Cargo.lock."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from script_cases import ROOT, script

licences = script("third_party_licenses")


def package(folder: Path, name: str, *, kind: str = "lib", own: bool = False, **texts: str) -> dict[str, Any]:
    """A crate as `cargo metadata` has it, with its sources in a folder."""
    (folder / name).mkdir()
    for file, text in texts.items():
        (folder / name / file.replace("_", "-")).write_text(text)
    return {
        "id": name,
        "name": name,
        "version": "1.0.0",
        "license": "MIT",
        "authors": [f"Author of {name}"],
        "source": None if own else "registry",
        "manifest_path": str(folder / name / "Cargo.toml"),
        "targets": [{"kind": [kind]}],
    }


def depends(*names: str, kind: str | None = None) -> list[dict[str, Any]]:
    return [{"pkg": name, "dep_kinds": [{"kind": kind}]} for name in names]


def crates(folder: Path) -> list[dict[str, Any]]:
    """gcnd_py → own → linked → deeper, with a macro, and crates of building and testing, beside."""
    packages = [
        package(folder, "gcnd_py", own=True),
        package(folder, "own", own=True),
        package(folder, "linked", LICENSE_MIT="MIT of A\r\n", LICENSE_GPL="GPL"),
        package(folder, "deeper", COPYING="MIT of A"),
        package(folder, "bare"),
        package(folder, "macro", kind="proc-macro", LICENSE="macro's"),
        package(folder, "under", LICENSE="under the macro"),
        package(folder, "build", LICENSE="build's"),
        package(folder, "test", LICENSE="test's"),
    ]
    edges = {
        "gcnd_py": depends("own", "macro") + depends("build", kind="build"),
        "own": depends("linked", "bare") + depends("test", kind="dev"),
        "linked": depends("deeper"),
        "macro": depends("under"),
    }
    nodes = [{"id": p["id"], "deps": edges.get(p["id"], [])} for p in packages]
    return licences.linked_crates({"packages": packages, "resolve": {"nodes": nodes}})


def test_only_linked_crates_of_others_count(tmp_path: Path) -> None:
    assert [crate["name"] for crate in crates(tmp_path)] == ["bare", "deeper", "linked"]


def test_texts_stand_once_and_crates_without_one_are_named_with_their_authors(tmp_path: Path) -> None:
    found = licences.document(crates(tmp_path))
    assert found.count("MIT of A") == 1
    assert "deeper 1.0.0 (MIT)\nlinked 1.0.0 (MIT)\n\nMIT of A\n" in found
    assert "bare 1.0.0 (MIT), Author of bare" in found
    assert "macro" not in found.replace("macros", "")
    assert "GPL\n" not in found


def test_crates_that_a_file_does_not_name_are_told(tmp_path: Path) -> None:
    found = crates(tmp_path)
    assert licences.missing(found, licences.document(found)) == []
    assert licences.missing(found, licences.document(found[1:])) == ["bare 1.0.0 (MIT)"]


def test_the_file_at_hand_is_of_the_locked_crates() -> None:
    text = licences.TARGET_FILE.read_text(encoding="utf-8")
    lock = (ROOT / "Cargo.lock").read_text(encoding="utf-8")
    locked = dict.fromkeys(re.findall(r'name = "(.+)"\nversion = "(.+)"\nsource', lock))
    listed = re.findall(r"^(\S+) (\d\S+) \(", text.split(licences.RULE)[0], flags=re.MULTILINE)
    assert len(listed) > 50
    assert [crate for crate in listed if crate not in locked] == []
    assert {"pyo3", "numpy", "rayon", "kiddo", "faer", "glam"} <= {name for name, _ in listed}
    assert len(licences.targets()) == 4


def test_it_is_in_the_wheels_licence_files() -> None:
    assert '"THIRD-PARTY-LICENSES"' in (ROOT / "pyproject.toml").read_text(encoding="utf-8")

"""The wheel check tells what is missing or too much in a wheel."""

from __future__ import annotations

import hashlib
import json
import zipfile
from pathlib import Path

import pytest

from script_cases import script

check_wheel = script("check_wheel")

NAME = "gcnd-1.0.0-cp310-abi3-manylinux_2_28_x86_64.whl"
INFO = "gcnd-1.0.0.dist-info"
WEIGHTS = b"weights"
CARD = json.dumps({"sha256": hashlib.sha256(WEIGHTS).hexdigest()}).encode()
SOUND = {
    "gcnd/__init__.py": b"",
    "gcnd/py.typed": b"",
    "gcnd/viewer/page.html": b"<html>",
    "gcnd/weights/default.json": CARD,
    "gcnd/weights/default.safetensors": WEIGHTS,
    "gcnd/_geom.abi3.so": b"",
    f"{INFO}/METADATA": b"",
    **{f"{INFO}/licenses/{name}": b"" for name in check_wheel.LICENCES},
}


@pytest.fixture
def package(tmp_path: Path) -> Path:
    folder = tmp_path / "gcnd"
    for name, data in SOUND.items():
        if name.startswith("gcnd/"):
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_bytes(data)
    (folder / "__pycache__").mkdir()
    (folder / "__pycache__" / "a.pyc").write_bytes(b"")
    return folder


def made_wheel(folder: Path, files: dict[str, bytes], name: str = NAME) -> Path:
    path = folder / name
    with zipfile.ZipFile(path, "w") as archive:
        for entry, data in files.items():
            archive.writestr(entry, data)
    return path


def test_a_sound_wheel_passes(tmp_path: Path, package: Path) -> None:
    assert check_wheel.problems(made_wheel(tmp_path, SOUND), package) == []


@pytest.mark.parametrize(
    ("lost", "told"),
    [
        ("gcnd/py.typed", "missing: gcnd/py.typed"),
        ("gcnd/viewer/page.html", "missing: gcnd/viewer/page.html"),
        ("gcnd/_geom.abi3.so", "no compiled module"),
        (f"{INFO}/licenses/LICENSE-MIT", "no licence: LICENSE-MIT"),
        (f"{INFO}/licenses/THIRD-PARTY-LICENSES", "no licence: THIRD-PARTY-LICENSES"),
        (
            f"{INFO}/licenses/python/gcnd/viewer/three/LICENSE",
            "no licence: python/gcnd/viewer/three/LICENSE",
        ),
    ],
)
def test_what_is_missing_is_told(tmp_path: Path, package: Path, lost: str, told: str) -> None:
    files = {name: data for name, data in SOUND.items() if name != lost}
    assert check_wheel.problems(made_wheel(tmp_path, files), package) == [told]


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({"gcnd/notes.txt": b""}, "not of the package: gcnd/notes.txt"),
        ({"tests/a.py": b""}, "not of the package: tests/a.py"),
        (
            {"gcnd/weights/default.safetensors": b"others"},
            "not the weights of their card: gcnd/weights/default.safetensors",
        ),
    ],
)
def test_what_is_wrong_is_told(tmp_path: Path, package: Path, more: dict[str, bytes], told: str) -> None:
    assert check_wheel.problems(made_wheel(tmp_path, SOUND | more), package) == [told]


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("gcnd-1.0.0-cp311-cp311-manylinux_2_28_x86_64.whl", "is not an abi3 wheel"),
        ("gcnd-1.0.0-cp310-abi3-linux_x86_64.whl", "not manylinux"),
    ],
)
def test_names_are_checked(tmp_path: Path, package: Path, name: str, told: str) -> None:
    (problem,) = check_wheel.problems(made_wheel(tmp_path, SOUND, name), package)
    assert told in problem


def test_this_python_is_at_hand() -> None:
    import sys

    assert sys.executable in check_wheel.pythons_at_hand()

"""The command `gcnd view`: the page that it writes, and what it leaves alone."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

import gcnd
from gcnd.cli import main
from gcnd.errors import GcndError
from gcnd.mesh_io import save
from view_cases import FACES, LIFTED, SQUARE, page_of


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "view.html"


@pytest.fixture
def paths(tmp_path: Path) -> dict[str, Path]:
    found = {name: tmp_path / f"{name}.ply" for name in ("clean", "noisy", "truth")}
    for path, vertices in zip(found.values(), (LIFTED, SQUARE + np.array([0, 0, 0.1]), SQUARE), strict=True):
        save((vertices, FACES), path)
    return found


def test_the_command_writes_the_page(
    paths: dict[str, Path], out: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [
        "view",
        str(paths["clean"]),
        "--against",
        str(paths["noisy"]),
        "--truth",
        str(paths["truth"]),
    ]
    assert main([*arguments, "--out", str(out)]) == 0
    printed = capsys.readouterr()
    assert printed.out == ""
    assert re.fullmatch(rf"wrote {re.escape(str(out))}: 2 faces, 0\.5 MB\n", printed.err)
    text = out.read_text(encoding="utf-8")
    assert "<title>clean.ply against noisy.ply</title>" in text
    assert 'id="tag-before">before: noisy.ply</p>' in text
    assert "<caption>Against truth.ply</caption>" in text

    assert main([*arguments, "--out", str(out), "--json"]) == 0
    by_hand = gcnd.view(paths["clean"], against=paths["noisy"], truth=paths["truth"], out=out)
    assert json.loads(capsys.readouterr().out) == asdict(by_hand)


def test_the_command_has_a_page_of_its_own_name(
    paths: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["view", "clean.ply", "--against", "noisy.ply"]) == 0
    assert json.loads(page_of(tmp_path / "view.html").texts["manifest"])["before"] == "noisy.ply"


def test_the_command_tells_errors(
    paths: dict[str, Path], out: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    other = tmp_path / "other.ply"
    save((SQUARE, FACES[:1]), other)
    assert main(["view", str(paths["clean"]), "--against", str(other), "--out", str(out)]) == 1
    error, blank, hint = capsys.readouterr().err.splitlines()
    assert (error, blank) == ("error: clean.ply has 2 faces and other.ply has 1", "")
    assert hint.startswith("hint: ")
    assert main(["view", str(paths["clean"]), "--out", str(out)]) == 2
    assert not out.exists()


@pytest.mark.skipif(os.name == "nt", reason="links need a right there")
@pytest.mark.parametrize("link", [os.symlink, os.link])
@pytest.mark.parametrize("which", ["after", "against", "truth"])
def test_a_page_replaces_no_mesh(
    paths: dict[str, Path], out: Path, which: str, link: Callable[[Path, Path], None]
) -> None:
    meshes = dict(zip(("after", "against", "truth"), paths.values(), strict=True))
    before = meshes[which].read_bytes()
    link(meshes[which], out)
    with pytest.raises(GcndError, match=r"view\.html is the input itself"):
        gcnd.view(**meshes, out=out)
    assert meshes[which].read_bytes() == before

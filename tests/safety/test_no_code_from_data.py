"""Weights, meshes and reports are data: nothing in the package runs what it reads, or unpacks it."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import gcnd

ROOT = Path(gcnd.__file__).parent

FORBIDDEN_MODULES = {
    "pickle",
    "cPickle",
    "_pickle",
    "dill",
    "cloudpickle",
    "joblib",
    "marshal",
    "shelve",
    "tarfile",
    "yaml",
}

FORBIDDEN_NAMES = {"eval", "exec", "compile", "__import__"}

FORBIDDEN_CALLS = {
    "torch.load",
    "torch.jit.load",
    "torch.hub.load",
    "shutil.unpack_archive",
    "os.system",
    "os.popen",
}

UNPACKING = {"extract", "extractall", "ZipFile"}


def faults(source: str) -> list[str]:
    """What a source does that it must not, by line."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            names = []
        for name in names:
            if name.partition(".")[0] in FORBIDDEN_MODULES or name.rpartition(".")[2] in UNPACKING:
                found.append(f"line {node.lineno}: import {name}")
        if not isinstance(node, ast.Call):
            continue
        called = ast.unparse(node.func)
        if isinstance(node.func, ast.Name) and called in FORBIDDEN_NAMES:
            found.append(f"line {node.lineno}: {called}")
        if called in FORBIDDEN_CALLS or (
            called.rpartition(".")[2] in {"extractall", "ZipFile"} or called.endswith("zip.extract")
        ):
            found.append(f"line {node.lineno}: {called}")
        keywords = {word.arg: ast.unparse(word.value) for word in node.keywords}
        if called in {"np.load", "numpy.load"} and keywords.get("allow_pickle") != "False":
            found.append(f"line {node.lineno}: np.load without allow_pickle=False")
        if keywords.get("shell", "False") != "False":
            found.append(f"line {node.lineno}: a shell")
    return found


@pytest.mark.parametrize(
    "path", sorted(ROOT.rglob("*.py")), ids=lambda path: path.relative_to(ROOT).as_posix()
)
def test_nothing_that_is_read_is_run_or_unpacked(path: Path) -> None:
    assert faults(path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    "source",
    [
        "import pickle", "from pickle import loads", "eval(x)", "exec(x)", "torch.load(p)", "np.load(p)", "import yaml",
        "np.load(p, allow_pickle=True)", "subprocess.run(x, shell=True)", "z.extractall(p)", "zipfile.ZipFile(p)",
        "from zipfile import ZipFile", "os.system(x)", "shutil.unpack_archive(p)",
    ],
)  # fmt: skip
def test_the_search_finds_each_of_them(source: str) -> None:
    assert len(faults(source)) == 1


def test_the_search_lets_the_rest_pass() -> None:
    assert faults("network.eval()\nre.compile(x)\nnp.load(p, allow_pickle=False)\nsubprocess.run(x)") == []

"""Command lines as nobody would type them, drawn at random, and running one in a folder of its own."""

from __future__ import annotations

import json
import os
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import strategies as st

from cli_cases import FACES, VERTICES
from gcnd.cli import main
from gcnd.mesh_io import SUPPORTED, load, save
from property_cases import cases

some = cases(40)

Files = dict[str, bytes | None]
"""Contents by path inside the folder that a command runs in; None of a folder."""


def a_folder_full() -> Files:
    """Meshes of every format, of any size, damaged and other; as bytes, to be written anew for every run."""
    found: Files = {
        "folder": None,
        "nothing": None,
        "bad": None,
        "bad/bad.ply": b"ply\n\xff\n",
        "empty.ply": b"",
    }
    found |= {"folder/bad.ply": b"ply\n\xff\n", "note.txt": b"not a mesh", "page.html": b"a page"}
    square = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n"
    with tempfile.TemporaryDirectory() as place:

        def add(name: str, vertices: Any, faces: Any = FACES) -> None:
            path = Path(place) / f"mesh{Path(name).suffix}"
            save((vertices, faces), path)
            found[name] = path.read_bytes()

        for suffix in SUPPORTED:
            add(f"in{suffix}", VERTICES)
        for name, scale in (
            ("tiny", 1e-200),
            ("small", 1e-100),
            ("large", 1e100),
            ("huge", 1e150),
            ("point", 0.0),
        ):
            add(f"{name}.ply", VERTICES * scale)
        add("folder/a.ply", VERTICES + 0.25)
        add("moved.ply", VERTICES + 0.1)
        add("other.ply", VERTICES, FACES[:2])
        add("网 'q\" [b].ply", VERTICES)
    return found | {"square.obj": square}


FULL = a_folder_full()
MESHES = [name for name, data in FULL.items() if data and "/" not in name and name.endswith(SUPPORTED)]

ODD = [
    "", " ", "-", "--", "-1", "0", "1", "3", "0.5", "nan", "inf", "-inf", "1e400", "-1e400", "1e-320", "1_0", "0x10",
    "99999999999999999999999", "9" * 5000, "٣", "²", "true", "None", "[/]", "[bold]", "\udcff", "网格", "a b", "\n",
    "$(x)", "%s", "{0}", "=", "a=b", ",", "'", '"', "*", "~", "x" * 300, "-x", "--json", "--help", "in.ply",
]  # fmt: skip


def is_argument(text: str) -> bool:
    """Whether a process can be given it, and it names nothing outside of the folder that the command runs in."""
    try:
        return b"\0" not in os.fsencode(text) and "/" not in text and text not in (".", "..")
    except UnicodeEncodeError:
        return False


odd = st.one_of(st.sampled_from(ODD), st.text(max_size=4).filter(is_argument))
reals = st.one_of(st.floats(0.0, 1.0).map(repr), st.sampled_from(["0", "1", "0.2", "1000"]))
counts = st.sampled_from(["0", "1", "3", "1000"])
inputs = st.one_of(st.just("in.ply"), st.sampled_from([*MESHES, "folder", "missing.ply", "note.txt"]))
outputs = st.one_of(
    st.just("out.ply"),
    st.sampled_from(
        [
            "out.obj",
            "out.stl",
            "out.off",
            "out.glb",
            "out.txt",
            "out",
            "no/out.ply",
            "folder",
            "moved.ply",
            "in.ply",
        ]
    ),
    odd.map(lambda text: f"{text}.ply"),
)
reports = st.sampled_from(["report.json", "out.ply", "in.ply", "no/report.json", "folder", "note.txt", ""])
FLAG = st.none()


class Line(NamedTuple):
    """A command line, and what of it names files.

    Attributes:
        arguments: Behind the program's name.
        read: Files and folders that must stay as they are.
        written: Files and folders that may be made or replaced.
    """

    arguments: list[str]
    read: set[str]
    written: set[str]


_READS = ("--against", "--truth", "IN")
_WRITES = ("--truth of noise", "--out", "--report", "OUT")


@st.composite
def lines(
    draw: st.DrawFn,
    command: str,
    positional: dict[str, st.SearchStrategy[str]],
    options: dict[str, st.SearchStrategy[Any]],
    always: dict[str, st.SearchStrategy[Any]] | None = None,
) -> Line:
    """Arguments of a command, most of them right: now and then one is odd, left out, or not known."""
    groups: list[list[str]] = []
    placed: list[list[str]] = []
    named: dict[str, set[str]] = {"read": set(), "written": set()}

    def add(name: str, group: list[str], value: str | None) -> None:
        groups.append(group)
        if value is not None and name in (*_READS, *_WRITES):
            named["read" if name in _READS else "written"].add(os.path.normpath(value))

    chosen = draw(st.lists(st.sampled_from(sorted(options)), max_size=4, unique=True))
    for name, values in ((always or {}) | {name: options[name] for name in chosen}).items():
        value = draw(
            odd if values is not FLAG and draw(st.integers(0, 9)) == 0 and name not in _READS else values
        )
        option = name.partition(" ")[0]
        add(name, [option] if value is None else [option, value], value)
    for name, values in positional.items():
        if draw(st.integers(0, 30)):
            value = draw(odd.filter(bool) if draw(st.integers(0, 20)) == 0 else values)
            add(name.split(" ")[0], [value], value)
            placed.append(groups[-1])
    if draw(st.integers(0, 20)) == 0:
        groups.append([draw(odd.filter(bool))])
        named["written"].add(os.path.normpath(groups[-1][0]))
    if draw(st.booleans()):
        # Options go anywhere; what is known by its place keeps its order.
        mixed = draw(st.permutations(groups))
        bare = iter([group for group in groups if group in placed])
        groups = [next(bare) if group in placed else group for group in mixed]
    arguments = [command, *(argument for group in groups for argument in group)]
    return Line(arguments, named["read"], named["written"])


# --- running one ---------------------------------------------------------------------------------------


@contextmanager
def working_in(files: Files) -> Iterator[Path]:
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as name:
        for path, data in files.items():
            (Path(name) / path).mkdir() if data is None else (Path(name) / path).write_bytes(data)
        os.chdir(name)
        try:
            yield Path(name)
        finally:
            os.chdir(before)


def files_in(folder: Path) -> Files:
    paths = (path for path in folder.rglob("*") if path.name != ".lock")
    return {str(path.relative_to(folder)): None if path.is_dir() else path.read_bytes() for path in paths}


def run(line: Line) -> tuple[int, str, str, Files]:
    """The exit code, what was printed, and the files afterwards; a warning of Python's own is an error."""
    out, err = StringIO(), StringIO()
    with working_in(FULL) as folder, warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        with redirect_stdout(out), redirect_stderr(err):
            code = main(line.arguments)
        after = files_in(folder)
        for name in after.keys() - FULL.keys():
            data = after[name] or b""
            if data[:1] in (b"{", b"["):  # a report, which may have any name
                json.loads(data, parse_constant=pytest.fail)
            elif name.endswith(SUPPORTED) and data:
                assert np.isfinite(load(folder / name).vertices).all()
    return code, out.getvalue(), err.getvalue(), after


def is_below(name: str, places: set[str]) -> bool:
    return any(name == place or name.startswith(f"{place}/") for place in places)


def check(line: Line) -> int:
    code, out, err, after = run(line)
    assert "Traceback" not in err
    changed = {name for name in FULL | after if FULL.get(name, b"") != after.get(name, b"")}
    is_folder = "folder" in line.arguments and not err.startswith(("error: ", "Usage: "))
    if code == 2:
        assert "Usage: gcnd" in err
        assert out == ""
    elif code == 1 and not is_folder:
        assert out == ""
        assert err.partition("error: ")[2].strip()
        assert err.count("error: ") == 1
    else:
        assert code == (1 if is_folder else 0), err
        assert "error: " not in err or is_folder
        if "--json" in line.arguments and "--help" not in line.arguments and not out.startswith("\n Usage"):
            json.loads(out, parse_constant=pytest.fail)
    if code == 0 or is_folder:
        # What was asked for, and nothing that was read.
        assert all(is_below(name, line.written) for name in changed), changed
        assert not any(is_below(name, line.read) for name in changed & FULL.keys()), changed
    else:
        assert changed == set()
    return code

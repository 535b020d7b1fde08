"""`gcnd.denoise_many` over files of any name and content, and arrays of any kind: each is told, and none stops it."""

from __future__ import annotations

import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from cli_cases import FACES, VERTICES
from gcnd.errors import GcndError
from gcnd.filters import Filter
from gcnd.many import denoise_many, mesh_files
from gcnd.mesh_io import SUPPORTED, load, save
from gcnd.report import write_report

TAUBIN = Filter("taubin", iterations=2)


def whole_files() -> dict[str, bytes]:
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"mesh{suffix}" for suffix in SUPPORTED]
        for path in paths:
            save((VERTICES, FACES), path)
        return {path.suffix: path.read_bytes() for path in paths}


WHOLE = whole_files()


@st.composite
def files(draw: st.DrawFn) -> tuple[bytes, bytes]:
    """A name of any bytes that a file may have, and a mesh, whole or cut off, or anything."""
    suffix = draw(st.sampled_from(SUPPORTED))
    stem = draw(st.binary(min_size=1, max_size=40).filter(lambda name: not {*name} & {*b"\0/"}))
    content = draw(st.sampled_from([WHOLE[suffix], WHOLE[suffix], b"ply\n\xff\n"]))
    end = draw(st.integers(0, len(content))) if draw(st.booleans()) else len(content)
    return stem + draw(st.sampled_from([suffix, suffix.upper()])).encode(), content[:end]


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not take any name")
@settings(max_examples=60, deadline=None)
@given(st.dictionaries(st.sampled_from([b".", b"deep"]), st.lists(files(), max_size=3), min_size=1))
def test_files_of_any_name_and_content(drawn: dict[bytes, list[tuple[bytes, bytes]]]) -> None:
    with tempfile.TemporaryDirectory() as place:
        folder, out, before = Path(place) / "in", Path(place) / "out", {}
        (folder / "deep").mkdir(parents=True)
        for inner, own in drawn.items():
            for name, content in own:
                before[os.path.normpath(os.path.join(os.fsencode(folder), inner, name))] = content
        for path, content in before.items():
            Path(os.fsdecode(path)).write_bytes(content)
        names = [path.relative_to(folder).as_posix() for path in mesh_files(folder)]
        assert len(names) == sum(not os.path.basename(path).startswith(b".") for path in before)
        if not names:
            return
        outcomes = denoise_many(folder, out, denoiser=TAUBIN, reports=True)
        assert [outcome.name for outcome in outcomes] == names
        for outcome in outcomes:
            content, result = before[os.fsencode(folder / outcome.name)], out / outcome.name
            assert (outcome.status == "done") == result.is_file()
            if outcome.status == "done":
                assert load(result).faces.shape == load(folder / outcome.name).faces.shape
            else:
                assert isinstance(outcome.error, GcndError)
                assert content not in WHOLE.values()
        write_report(Path(place) / "report.json", [[o.name, o.report] for o in outcomes])
        assert [row[0] for row in json.loads((Path(place) / "report.json").read_bytes())] == names
        assert {path: Path(os.fsdecode(path)).read_bytes() for path in before} == before


ANY_ARRAY = arrays.arrays(
    st.sampled_from([np.float64, np.float32, np.int64, np.uint8, np.bool_, np.complex128]),
    arrays.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=5),
)
CORNERS = arrays.arrays(np.int64, st.tuples(st.integers(0, 6), st.just(3)), elements=st.integers(-1, 5))
POINTS = arrays.arrays(np.float64, st.tuples(st.integers(3, 5), st.just(3)), elements=st.floats(width=32))


@pytest.mark.filterwarnings("ignore::gcnd.MeshWarning")
@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(POINTS | ANY_ARRAY, CORNERS | ANY_ARRAY), min_size=1, max_size=4))
def test_arrays_of_any_kind(meshes: list[tuple[Any, Any]]) -> None:
    given_bytes = [(vertices.tobytes(), faces.tobytes()) for vertices, faces in meshes]
    outcomes = denoise_many([*meshes, (VERTICES, FACES)], denoiser=TAUBIN, reports=True)
    assert [outcome.name for outcome in outcomes] == [f"mesh {index}" for index in range(len(meshes) + 1)]
    assert outcomes[-1].status == "done"
    for outcome, (vertices, faces) in zip(outcomes, meshes, strict=False):
        if outcome.status == "done":
            json.dumps(outcome.report, allow_nan=False)
            after, same = outcome.denoised.mesh  # type: ignore[union-attr]
            assert after.shape == vertices.shape
            assert np.isfinite(after).all()
            assert np.array_equal(same, faces)
        else:
            assert isinstance(outcome.error, GcndError)
    assert [(vertices.tobytes(), faces.tobytes()) for vertices, faces in meshes] == given_bytes

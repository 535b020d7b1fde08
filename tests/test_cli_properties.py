"""The command line under any arguments: it does what it is told, or says why not in one message and leaves no trace."""

from __future__ import annotations

import sys

import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from gcnd.filters import list_filters
from line_cases import FLAG, Line, check, counts, inputs, lines, odd, outputs, reals, reports, some

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="other systems do not take any name")


def line_of(command: str, source: str, result: str, *options: str) -> Line:
    return Line([command, source, result, *options], {source}, {result, result.removesuffix(".ply")})


PARAMETERS = sorted({name for info in list_filters() for name in info.parameters} | {"lambda", "nope", ""})
VALUES = [
    "0",
    "1",
    "3",
    "0.5",
    "-1",
    "nan",
    "inf",
    "1e400",
    "1e-320",
    "1e300",
    "true",
    "",
    "99999999999999999999999",
]
settings_of = st.tuples(
    st.sampled_from(PARAMETERS), st.sampled_from(["=", "=", "=", ""]), st.sampled_from(VALUES)
)
filters = st.one_of(st.just("taubin"), st.sampled_from([info.name for info in list_filters()]))

CONTROLS = {
    "--device": st.sampled_from(["cpu", "cuda", "tpu"]),
    "--seed": counts,
    "--normal-iterations": counts,
    "--vertex-iterations": counts,
    "--boundary": st.sampled_from(["free", "along", "fixed"]),
    "--triangulate": FLAG,
    "--strength": reals,
    "--max-displacement": reals,
    "--max-displacement-edges": reals,
    "--keep": odd,
    "--preserve-volume": FLAG,
    "--confidence": FLAG,
    "--report": reports,
    "--overwrite": FLAG,
    "--quiet": FLAG,
    "--json": FLAG,
}
FILTERED = CONTROLS | {"--param": settings_of.map("".join), "--preset": odd}
IN_OUT = {"IN": inputs, "OUT": outputs}


@settings(some, max_examples=60)
@given(lines("denoise", IN_OUT, FILTERED, {"--method": filters}))
@example(line_of("denoise", "x" * 300 + ".ply", "out.ply", "--method", "taubin"))
@example(line_of("denoise", "in.ply", "in.ply", "--method", "taubin"))
@example(line_of("denoise", "in.ply", "out.ply", "--method", "taubin", "--param", "iterations=nan"))
@example(line_of("denoise", "huge.ply", "out.stl", "--method", "taubin", "--preserve-volume"))
@example(line_of("denoise", "in.ply", "out.ply", "--method", "taubin", "--report", "in.ply"))
@example(line_of("denoise", "huge.ply", "out.json.ply", "--method", "taubin", "--report", "out.json"))
def test_denoise_with_a_filter(line: Line) -> None:
    check(line)


@settings(some, max_examples=12)
@given(lines("denoise", IN_OUT, CONTROLS, {"--preset": st.just("fast")}))
def test_denoise_with_a_preset(line: Line) -> None:
    check(line)


NOISE = {
    "--kind": st.sampled_from(["gaussian", "impulsive", "isotropic", "print", "kinect1", "fusion", "nope"]),
    "--fraction": reals,
    "--truth of noise": outputs,
    # Of 2 cm at 80 cm: a scan of few pixels, soon made.
    "--distance": st.just("0.8"),
    "--triangulate": FLAG,
    "--seed": counts,
}


@settings(some, max_examples=60)
@given(lines("noise", IN_OUT, NOISE, {"--level": reals}))
@example(line_of("noise", "tiny.ply", "out.ply", "--level", "0.2"))
@example(line_of("noise", "large.ply", "out.ply", "--level", "0.2"))
@example(line_of("noise", "in.ply", "in.ply", "--level", "0.2"))
@example(line_of("noise", "in.ply", "out.ply", "--level", "0.2", "--fraction", "nan"))
@example(line_of("noise", "huge.ply", "out.obj", "--level", "1000"))
def test_noise(line: Line) -> None:
    check(line)


SCANS = NOISE | {"--level": reals}


@settings(some, max_examples=60)
@given(
    lines(
        "noise", IN_OUT, SCANS, {"--kind": st.sampled_from(["print", "kinect1"]), "--size": st.just("0.02")}
    )
)
@example(line_of("noise", "point.ply", "out.ply", "--kind", "print"))
@example(line_of("noise", "in.ply", "out.ply", "--kind", "kinect1", "--size", "0.02", "--truth", "in.ply"))
def test_noise_of_a_scan(line: Line) -> None:
    # Fusion takes seconds.
    assume("fusion" not in line.arguments)
    check(line)


PAGES = st.one_of(
    st.just("out.html"), st.sampled_from(["page.html", "in.ply", "no/out.html", "folder", "out.txt", ""])
)
VIEW = {"--truth": inputs, "--json": FLAG}


@some
@given(lines("view", {"IN": inputs}, VIEW, {"--against": inputs, "--out": PAGES}))
def test_view(line: Line) -> None:
    check(line)


@some
@given(lines("info", {"IN": inputs}, {"--json": FLAG}))
def test_info(line: Line) -> None:
    check(line)


@settings(some, max_examples=10)
@given(lines("models", {}, {"--json": FLAG, "--seed": odd}))
def test_models(line: Line) -> None:
    check(line)


@some
@given(
    lines(
        "evaluate",
        {"IN": inputs, "IN too": inputs},
        {"--json": FLAG, "--seed": counts},
        {"--samples": counts},
    )
)
def test_evaluate(line: Line) -> None:
    assume("99999999999999999999999" not in line.arguments)
    check(line)


METHODS = [
    "taubin",
    "fast",
    "nope",
    "taubin[iterations=nan]",
    "taubin[]",
    "taubin[iterations=1",
    "l0[beta=-1]",
    ",",
]
COMPARE = {
    "--noise": st.sampled_from(["gaussian", "gaussian,print", "nope", ","]),
    "--levels": st.sampled_from(["0.1", "0.1,nan", "1e400", "-1", "a", ","]),
    "--fraction": reals,
    "--seed": counts,
    "--shapes": counts,
    "--split": st.sampled_from(["test", "train", "nope"]),
    "--threads": counts,
    "--timeout": reals,
    "--samples": counts,
    "--pictures": st.sampled_from(["one", "all", "none", "nope"]),
    "--retry-failed": FLAG,
    "--quiet": FLAG,
    "--json": FLAG,
}
DATASETS = st.sampled_from(["missing", "nothing", "bad", "in.ply", "note.txt"])
FOLDERS = st.sampled_from(["out", "folder", "in.ply", "no/out", "note.txt/out"])


@some
@given(lines("compare", {"IN": DATASETS}, COMPARE, {"--methods": st.sampled_from(METHODS), "--out": FOLDERS}))
@example(Line(["compare", "in.ply", "--out", "out", "--methods", "taubin"], {"in.ply"}, set()))
@example(Line(["compare", "bad", "--out", "out", "--methods", "taubin", "--noise", "nope"], {"bad"}, set()))
@example(Line(["compare", "bad", "--out", "out", "--methods", "taubin", "--levels", "nan"], {"bad"}, set()))
def test_compare_of_nothing(line: Line) -> None:
    assert check(line) != 0 or "--help" in line.arguments


@some
@given(st.lists(odd, max_size=3))
def test_no_command_at_all(arguments: list[str]) -> None:
    assert check(Line(arguments, set(), set())) in (0, 1, 2)

"""The workflows of .github: they parse, pin what they run, ask for few rights, and do what .ci/run does."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

yaml = pytest.importorskip("yaml")

ROOT = Path(__file__).parent.parent
FOLDER = ROOT / ".github" / "workflows"
NAMES = ("ci", "release", "wheels")
PINNED = re.compile(r"[\w-]+/[\w-]+@[0-9a-f]{40}")
COMMENTED = re.compile(r"uses: (\S+)( # v\d+\.\d+\.\d+)?$", re.MULTILINE)


def text(name: str) -> str:
    return (FOLDER / f"{name}.yml").read_text(encoding="utf-8")


def workflow(name: str) -> dict[str, Any]:
    read: dict[str, Any] = yaml.safe_load(text(name))
    return read


def steps(name: str) -> Iterator[dict[str, Any]]:
    for job in workflow(name)["jobs"].values():
        yield from job.get("steps", [])


def test_these_are_all() -> None:
    assert sorted(path.name for path in FOLDER.iterdir()) == [f"{name}.yml" for name in NAMES]


@pytest.mark.parametrize("name", NAMES)
def test_actions_are_pinned_and_say_their_version(name: str) -> None:
    used = COMMENTED.findall(text(name))
    assert used
    for action, version in used:
        if not action.startswith("./"):
            assert PINNED.fullmatch(action), action
            assert version, action


@pytest.mark.parametrize("name", NAMES)
def test_rights_are_few(name: str) -> None:
    read = workflow(name)
    assert read["permissions"] == {"contents": "read"}
    for job_name, job in read["jobs"].items():
        allowed = {"id-token": "write"} if (name, job_name) == ("release", "publish") else None
        assert job.get("permissions") == allowed
        assert "timeout-minutes" in job or "uses" in job
    for step in steps(name):
        if step.get("uses", "").startswith("actions/checkout@"):
            assert step["with"]["persist-credentials"] is False
    assert "secrets." not in text(name)


@pytest.mark.parametrize("name", NAMES)
def test_what_outsiders_name_never_reaches_a_shell(name: str) -> None:
    for step in steps(name):
        assert "${{" not in step.get("run", "")


def test_files_that_workflows_name_exist() -> None:
    for name in NAMES:
        for path in re.findall(r"(?:\./|python )((?:\.github|scripts)/\S+)", text(name)):
            assert (ROOT / path).is_file(), path


def test_systems_and_pythons() -> None:
    matrix = workflow("ci")["jobs"]["test"]["strategy"]["matrix"]
    assert {system.split("-")[0] for system in matrix["os"]} == {"ubuntu", "macos", "windows"}
    assert matrix["python"] == ["3.10", "3.13"]


def test_the_tests_are_those_of_make() -> None:
    """`make` has no Windows, so that job spells its lines out; they must stay the same."""
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    body = re.search(r"^test-rust:.*?(?=^lint:)", makefile, re.MULTILINE | re.DOTALL)
    assert body is not None
    lines = [line.strip().replace("$(BIN)/", "") for line in body[0].splitlines() if line.startswith("\t")]
    run = [step["run"] for step in workflow("ci")["jobs"]["test"]["steps"] if "run" in step]
    assert len(lines) == 3
    assert run[-3:] == lines
    ci_lines = (ROOT / ".ci" / "run").read_text(encoding="utf-8").splitlines()
    assert [line for line in ci_lines if line.startswith("make ")] == ["make test", "make lint"]
    assert "make lint" in [step.get("run") for step in workflow("ci")["jobs"]["lint"]["steps"]]


def test_publishing_waits_for_the_wheels_and_the_version() -> None:
    jobs = workflow("release")["jobs"]
    assert jobs["publish"]["needs"] == "wheels"
    assert jobs["wheels"]["needs"] == "version"
    assert jobs["publish"]["environment"] == "release"

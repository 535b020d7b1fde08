"""The presets that the panel offers: those of every gcnd, or all that the installed one lists. Needs no Blender."""

from __future__ import annotations

import json
import subprocess

from .errors import Failure
from .runs import NO_WINDOW, told_error

__all__ = ["KNOWN", "Preset", "from_command", "from_python", "parsed", "stored"]

Preset = tuple[str, str]
"""Name, and one line about it."""

AUTO: Preset = ("auto", "Chooses the weights by the mesh")

KNOWN: tuple[Preset, ...] = (
    AUTO,
    ("default", "The most accurate weights"),
    ("fast", "Several times as fast, less accurate"),
)

_SECONDS = 60


def from_command(command: tuple[str, ...]) -> tuple[Preset, ...]:
    """Asks `gcnd models --json`.

    Raises:
        Failure: The command cannot be run, or answers something else.
    """
    try:
        done = subprocess.run(
            [*command, "models", "--json"],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=_SECONDS,
            creationflags=NO_WINDOW,
            check=False,
        )
    except OSError as error:
        raise Failure(f"{command[0]} cannot be started: {error.strerror or error}") from error
    except subprocess.TimeoutExpired as error:
        raise Failure(f"{command[0]} did not answer for {_SECONDS} seconds") from error
    if done.returncode != 0:
        raise told_error(done.stderr.splitlines(), done.returncode)
    return (AUTO, *parsed(done.stdout))


def from_python() -> tuple[Preset, ...]:
    """Asks the gcnd of this Python, which takes the seconds that importing torch takes.

    Raises:
        Failure: It cannot be imported.
    """
    try:
        from gcnd.weights import list_models
    except ImportError as error:
        raise Failure(f"gcnd cannot be imported: {error}") from error
    return (AUTO, *((model.name, model.description) for model in list_models()))


def parsed(text: str) -> tuple[Preset, ...]:
    """Reads presets from JSON: a list of objects that have a name and a description.

    Raises:
        Failure: It is something else.
    """
    try:
        presets = tuple((str(model["name"]), str(model["description"])) for model in json.loads(text))
    except (ValueError, TypeError, KeyError) as error:
        raise Failure("The program does not list presets as gcnd does", "set the path of gcnd") from error
    if not presets:
        raise Failure("The program lists no presets", "set the path of gcnd")
    return presets


def stored(presets: tuple[Preset, ...]) -> str:
    """Writes presets as the JSON that `parsed` reads."""
    return json.dumps([{"name": name, "description": text} for name, text in presets])

"""Which methods a comparison runs: their names, settings in brackets, groups, and what of it is installed."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

import gcnd
from gcnd.auto import AUTO, CANDIDATES
from gcnd.compare.adapters import LIBRARIES, Adapted, Library
from gcnd.compare.own import PRESET_SETTINGS
from gcnd.errors import ConfigError, GcndError, check_count
from gcnd.filters import Filter, finite, list_filters, parse_parameters

__all__ = [
    "BEST_OF_SIGMA_R",
    "GROUPS",
    "Method",
    "available",
    "classical_labels",
    "known_names",
    "parse_methods",
]

BEST_OF_SIGMA_R = (0.2, 0.35, 0.45)
"""The values of σ_r over which a normal filter is taken at its best, as the field's papers do."""

GROUPS: dict[str, str] = {
    "presets": "every shipped preset",
    "filters": "every filter of gcnd at its defaults",
    "classical": "every filter of gcnd, those with sigma_r at 0.2, 0.35 and 0.45, and trimesh's Taubin and Humphrey",
    "libraries": "every method of every other library, documented defaults and tuned",
    "all": "presets, classical and libraries",
}
"""What a group's name stands for; the name of a library stands for all of its methods."""

_TETRAHEDRON = (np.eye(4, 3), np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
"""The smallest mesh that any filter takes."""

_TRIMESH_CLASSICAL = ("taubin", "taubin-tuned", "humphrey", "humphrey-tuned")
_WITH_SETTINGS = re.compile(r"([^\[\]]+)(?:\[([^\[\]]*)\])?")
_COMMA_OUTSIDE_BRACKETS = re.compile(r",(?![^\[]*\])")


@dataclass(frozen=True)
class Method:
    """Describes one method at one setting.

    Attributes:
        label: How it is called in tables: its name, with what was set in brackets.
        family: Its name alone.
        source: "gcnd" or the library.
        entry: "module:function" of what makes it ready.
        settings: Keywords of that function.
        version: Of what runs: a library's version; with a preset also its weights.
    """

    label: str
    family: str
    source: str
    entry: str
    settings: Mapping[str, Any] = field(hash=False)
    version: str

    @property
    def identity(self) -> tuple[str, str]:
        """What runs, whatever it is called."""
        return self.entry, repr(sorted(self.settings.items(), key=lambda item: item[0]))


def parse_methods(texts: Iterable[str]) -> list[Method]:
    """Reads names of methods and groups.

    A name is a preset or the path of a weights file, a filter of gcnd, or ``library:method``; settings follow in
    brackets: ``guided-normal[sigma_r=0.2,normal_iterations=10]``. What two names have in common runs once.

    Args:
        texts: Names, or several of them separated by commas.

    Returns:
        The methods in the order of their names.

    Raises:
        ConfigError: A name or a setting is unknown, a value is not of its kind or out of range, or there is no name.
        WeightsError: A weights file cannot be read.

    Example:
        >>> [method.label for method in parse_methods(["l0,guided-normal[sigma_r=0.2]", "l0"])]
        ['l0', 'guided-normal[sigma_r=0.2]']
    """
    names = [part.strip() for text in texts for part in _COMMA_OUTSIDE_BRACKETS.split(text)]
    found: dict[tuple[str, str], Method] = {}
    for name in filter(None, names):
        for method in _expanded(name):
            found.setdefault(method.identity, method)
    if not found:
        raise ConfigError("no method is named", hint=_known())
    return list(found.values())


def available(methods: Sequence[Method]) -> tuple[list[Method], list[str]]:
    """Sorts out the methods of libraries that are not there.

    Each library is imported once, in a process of its own: one that is installed and does not load is missing too.

    Returns:
        The methods that can run, and for each missing library a line that says what is skipped and why.
    """
    lines = {}
    for source in dict.fromkeys(method.source for method in methods):
        reason = _missing(LIBRARIES[source]) if source in LIBRARIES else None
        if reason is not None:
            skipped = [method.label for method in methods if method.source == source]
            lines[source] = f"skipped {', '.join(skipped)}: {reason}"
    return [method for method in methods if method.source not in lines], list(lines.values())


def known_names() -> list[str]:
    """Returns every name that needs no path: groups, presets, filters, libraries and their methods."""
    names = [*GROUPS, AUTO, *_presets(), *(info.name for info in list_filters())]
    for library in LIBRARIES.values():
        names += [library.name, *(f"{library.name}:{method}" for method in library.methods)]
    return names


def classical() -> list[Method]:
    """Returns the methods of the group ``classical``, over which "best classical" is the best."""
    methods = []
    for info in list_filters():
        if "sigma_r" in info.parameters:
            methods += [_filter(info.name, f"sigma_r={value}") for value in BEST_OF_SIGMA_R]
        else:
            methods.append(_filter(info.name, None))
    return methods + [_adapted("trimesh", name, None) for name in _TRIMESH_CLASSICAL]


def classical_labels(methods: Iterable[Method]) -> list[str]:
    """Returns the labels of those methods that belong to the group ``classical``, whatever they are called."""
    known = {method.identity for method in classical()}
    return [method.label for method in methods if method.identity in known]


def _expanded(text: str) -> list[Method]:
    match = _WITH_SETTINGS.fullmatch(text)
    if match is None:
        raise ConfigError(f"cannot read the method {text!r}", hint="write name[setting=value,setting=value]")
    name, settings = match[1].strip(), match[2]
    if name in GROUPS or name in LIBRARIES:
        if settings is not None:
            raise ConfigError(f"{name} is a group and takes no settings", hint="name its methods one by one")
        return _group(name)
    source, colon, method = name.partition(":")
    if colon and source in LIBRARIES:
        return [_adapted(source, method, settings)]
    if any(info.name == name for info in list_filters()):
        return [_filter(name, settings)]
    if name in (AUTO, *_presets()) or name.endswith(".safetensors"):
        return [_preset(name, settings)]
    raise ConfigError(f"there is no method {name!r}", hint=_known())


def _group(name: str) -> list[Method]:
    if name in LIBRARIES:
        return [_adapted(name, method, None) for method in LIBRARIES[name].methods]
    if name == "presets":
        return [_preset(preset, None) for preset in _presets()]
    if name == "filters":
        return [_filter(info.name, None) for info in list_filters()]
    if name == "classical":
        return classical()
    if name == "libraries":
        return [method for library in LIBRARIES for method in _group(library)]
    return [*_group("presets"), *_group("classical"), *_group("libraries")]


def _known() -> str:
    return f"methods and groups are {', '.join(known_names())}; docs/compare.md describes them"


def _presets() -> list[str]:
    from gcnd.weights.registry import list_models

    return [info.name for info in list_models()]


def _preset(name: str, settings: str | None) -> Method:
    given = _pairs(name, settings)
    chosen = dict(PRESET_SETTINGS)
    for key, text in given.items():
        if key not in chosen:
            raise ConfigError(f"{name} has no setting {key!r}", hint=f"its settings are {', '.join(chosen)}")
        chosen[key] = _preset_value(name, key, text)
    label = _label(name, given)
    source = f"{gcnd.__version__} {_weights_hash(name)}"
    return Method(label, name, "gcnd", "gcnd.compare.own:network", {"preset": name, **chosen}, source)


def _preset_value(name: str, key: str, text: str) -> int:
    from gcnd.nn.cascade import MOST_ITERATIONS

    try:
        value = int(text)
    except ValueError:
        raise ConfigError(f"{name}: {key} is {text}, allowed: a whole number, 0 or more") from None
    try:
        check_count(key, value, *([MOST_ITERATIONS] if "iterations" in key else []))
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}") from error
    return value


def _weights_hash(name: str) -> str:
    from gcnd.weights.registry import list_models, load_config_of, weights_hash

    hashes = {info.name: info.sha256 for info in list_models()}
    if name == AUTO:
        return "+".join(hashes[candidate][:12] for candidate in CANDIDATES)
    if name in hashes:
        return hashes[name][:12]
    path = Path(name)
    if not path.is_file():
        raise ConfigError(f"no such weights file: {path}", hint=_known())
    load_config_of(name)
    return weights_hash(name)[:12]


def _filter(name: str, settings: str | None) -> Method:
    given = _pairs(name, settings)
    defaults = next(info.parameters for info in list_filters() if info.name == name)
    chosen = {**defaults, **parse_parameters(name, given)}
    if given:
        _check_ranges(name, chosen)
    entry = "gcnd.compare.own:filtered"
    return Method(_label(name, given), name, "gcnd", entry, {"method": name, **chosen}, gcnd.__version__)


def _check_ranges(name: str, parameters: Mapping[str, Any]) -> None:
    """Tells what is out of range now and not in every run: an iteration on the smallest of meshes."""
    try:
        Filter(name, **parameters)
        once = {key: min(value, 1) if "iterations" in key else value for key, value in parameters.items()}
        Filter(name, **once).run(_TETRAHEDRON)
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}", error.hint) from error
    except GcndError:
        # It diverges, or wants more memory than there is; whether it does so on a mesh is that run's row to tell.
        return


def _adapted(source: str, method: str, settings: str | None) -> Method:
    library = LIBRARIES[source]
    name = f"{source}:{method}"
    if method not in library.methods:
        hint = f"{source} has {', '.join(f'{source}:{known}' for known in library.methods)}"
        raise ConfigError(f"there is no method {name!r}", hint=hint)
    adapted = library.methods[method]
    given = _pairs(name, settings)
    chosen = {**adapted.settings, **{key: _value(name, adapted, key, text) for key, text in given.items()}}
    entry = f"{adapted.make.__module__}:{adapted.make.__name__}"
    return Method(_label(name, given), name, source, entry, chosen, _version(source))


def _value(name: str, adapted: Adapted, key: str, text: str) -> bool | int | float:
    if key not in adapted.settings:
        names = ", ".join(adapted.settings) or "none"
        raise ConfigError(f"{name} has no setting {key!r}", hint=f"its settings are {names}")
    kind = type(adapted.settings[key])
    try:
        return {"true": True, "false": False}[text.lower()] if kind is bool else finite(kind(text))
    except (KeyError, ValueError, OverflowError):
        allowed = {bool: "true or false", int: "a whole number"}.get(kind, "a number")
        raise ConfigError(f"{key} is {text}, allowed: {allowed}") from None


def _pairs(name: str, settings: str | None) -> dict[str, str]:
    pairs: dict[str, str] = {}
    for part in filter(None, (part.strip() for part in (settings or "").split(","))):
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not (key and equals and value):
            raise ConfigError(f"{name} is given {part!r}, allowed: NAME=VALUE")
        if key in pairs:
            raise ConfigError(f"{name} is given {key} twice, allowed: once")
        pairs[key] = value
    return pairs


def _label(name: str, given: Mapping[str, str]) -> str:
    return f"{name}[{','.join(f'{key}={value}' for key, value in given.items())}]" if given else name


def _version(source: str) -> str:
    try:
        return version(source)
    except PackageNotFoundError:
        return "missing"


def _missing(library: Library) -> str | None:
    """Why a library cannot be used, or None."""
    if find_spec(library.module.partition(".")[0]) is None:
        return f"{library.name} is not installed (pip install 'gcnd[compare]')"
    command = [sys.executable, "-c", f"import {library.module}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode == 0:
        return None
    lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
    hint = f"; {library.hint}" if library.hint else ""
    return f"{library.name} cannot be imported: {lines[-1].strip()}{hint}"

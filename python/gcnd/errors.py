"""The exceptions that gcnd raises for input it cannot use, and its warning.

Every one carries a message that names what is wrong and, where there is one, a hint that says what to do
about it; the command line prints both and shows no traceback.
"""

from __future__ import annotations

import operator
from typing import overload

__all__ = [
    "Cancelled",
    "ConfigError",
    "GcndError",
    "MeshError",
    "MeshWarning",
    "WeightsError",
    "check_count",
    "check_progress",
    "check_real",
    "check_whole",
]


class GcndError(Exception):
    """Reports something the caller can put right; the base of all of gcnd's exceptions.

    Args:
        message: What is wrong, with the ids and values that show it.
        hint: What to do about it, or None.

    Example:
        >>> error = GcndError("face 3 has 4 corners, not 3", hint="triangulate the mesh first")
        >>> str(error), error.hint
        ('face 3 has 4 corners, not 3', 'triangulate the mesh first')
    """

    hint: str | None

    def __init__(self, message: str, hint: str | None = None) -> None:
        super().__init__(message)
        self.hint = hint

    def __reduce__(self) -> tuple[type[GcndError], tuple[str, str | None]]:
        # Exception's own pickling forgets the hint, and errors cross process borders in data loading.
        return type(self), (str(self), self.hint)


class MeshError(GcndError, ValueError):
    """Reports a mesh, or a mesh file, that cannot be read, worked on or written."""


class ConfigError(GcndError, ValueError):
    """Reports a parameter outside its allowed values."""


class WeightsError(GcndError):
    """Reports network weights that are missing, damaged or do not fit."""


class Cancelled(GcndError):
    """Reports that a progress callback asked to stop; nothing was written or changed."""


class MeshWarning(UserWarning):
    """Warns of a mesh that is worked on, but not as it is or not to much use; the command line tells it in a line."""


def check_whole(name: str, value: object, least: int, most: int) -> None:
    """Checks a whole number that was read from a file, its type included.

    Args:
        name: Of the parameter.
        value: What was read.
        least: Smallest allowed value.
        most: Largest allowed value.

    Raises:
        ConfigError: If it is no whole number, or out of range.

    Example:
        >>> check_whole("passes", "3", 1, 100)
        Traceback (most recent call last):
        gcnd.errors.ConfigError: passes is '3', allowed: a whole number, 1 to 100
    """
    if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= most:
        raise ConfigError(f"{name} is {value!r}, allowed: a whole number, {least} to {most}")


def check_real(name: str, value: object, least: float, most: float) -> None:
    """Checks a number that was read from a file, its type included; arguments and errors as of `check_whole`."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not least <= value <= most:
        raise ConfigError(f"{name} is {value!r}, allowed: a number, {least:g} to {most:g}")


@overload
def check_count(name: str, value: int, most: int = ...) -> int: ...


@overload
def check_count(name: str, value: None, most: int = ...) -> None: ...


def check_count(name: str, value: int | None, most: int = 2**64 - 1) -> int | None:
    """Checks that a count or a seed is a whole number and, as most of them must, fits the geometry core's 64 bits.

    Args:
        name: Of the parameter, as the caller knows it.
        value: What was given, of Python or numpy; None, which stands for a default, passes.
        most: Largest allowed value.

    Returns:
        The same as a number of Python's own, which the core and JSON take.

    Raises:
        ConfigError: If it is no whole number, below 0, or above ``most``.

    Example:
        >>> check_count("seed", 2**64 - 1)
        18446744073709551615
        >>> check_count("seed", -1)
        Traceback (most recent call last):
        gcnd.errors.ConfigError: seed is -1, allowed: 0 or more
    """
    if value is None:
        return None
    try:
        count = None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        count = None
    if count is None:
        raise ConfigError(f"{name} is {value!r}, allowed: a whole number, 0 or more")
    if not 0 <= count <= most:
        largest = "below 2**64" if most == 2**64 - 1 else f"0 to {most}"
        raise ConfigError(f"{name} is {count}, allowed: {'0 or more' if count < 0 else largest}")
    return count


def check_progress(progress: object) -> None:
    """Checks that what is to be told of progress can be called, before any work.

    Args:
        progress: What was given; None, for telling nobody, passes.

    Raises:
        ConfigError: If it is something else.

    Example:
        >>> check_progress(print)
        >>> check_progress(3)
        Traceback (most recent call last):
        gcnd.errors.ConfigError: progress is 3, allowed: a function, or None
    """
    if progress is not None and not callable(progress):
        raise ConfigError(f"progress is {progress!r}, allowed: a function, or None")

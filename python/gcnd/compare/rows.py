"""One row per method and mesh, in a file that grows as rows are finished and that a later run goes on with."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

from gcnd.errors import ConfigError
from gcnd.formats.atomic import encoded

__all__ = ["INPUT", "Row", "RowFile", "json_bytes", "printable"]

INPUT = "noisy"
"""The method of the rows that tell the errors of the input itself."""


def printable(name: str) -> str:
    r"""Returns a file's name as it can be written: a byte that is not UTF-8 as ``\xNN``.

    Example:
        >>> printable("b\udcff.ply")
        'b\\xff.ply'
    """
    return os.fsencode(name).decode("utf-8", "backslashreplace")


def json_bytes(value: Any, indent: int | None = None) -> bytes:
    """Returns a value as JSON in UTF-8; of a path that is not, it is read back the same."""
    return encoded(json.dumps(value, indent=indent, ensure_ascii=False))


@dataclass(frozen=True)
class Row:
    """Tells what one method did with one mesh; what is not known or does not apply is None.

    Attributes:
        key: Stands for method, settings, version, arrays, threads and samples: equal keys are one run.
        mesh: Name of the mesh.
        kind: Of the mesh.
        noise: Kind of noise.
        level: Of the noise.
        faces: Of the mesh.
        method: Label of the method, `INPUT` for the input.
        family: The method without its settings.
        source: "gcnd", a library, or "input".
        version: Of what ran.
        settings: All of them.
        error: Why there is no result, in a line.
        seconds: Of the method alone.
        peak_mib: Most memory that its process held.
        added_mib: Of it, what came on top of what it held before the method began.
        e_a: See `gcnd.compare.measures.Measures`, as the rest.
        e_v: As there.
        displacement_mean: As there.
        displacement_max: As there.
        flipped: As there.
        volume_change: As there.
        chosen: In a "best of" row, the method that was best.
    """

    key: str
    mesh: str
    kind: str
    noise: str
    level: str
    faces: int
    method: str
    family: str
    source: str
    version: str
    settings: dict[str, Any]
    error: str | None = None
    seconds: float | None = None
    peak_mib: float | None = None
    added_mib: float | None = None
    e_a: float | None = None
    e_v: float | None = None
    displacement_mean: float | None = None
    displacement_max: float | None = None
    flipped: int | None = None
    volume_change: float | None = None
    chosen: str | None = None

    @property
    def case(self) -> tuple[str, str, str]:
        """Mesh, noise and level."""
        return self.mesh, self.noise, self.level


_HINTS = get_type_hints(Row)


def _read_row(values: dict[str, Any]) -> Row:
    """A row from JSON; raises ``TypeError`` or ``ValueError`` where a value cannot be one of a row."""
    row = Row(**{name: value for name, value in values.items() if name in _HINTS})
    for name, hint in _HINTS.items():
        if not _is(getattr(row, name), hint):
            raise TypeError(name)
    if row.error is None and row.faces < 1:
        raise ValueError("a result has faces")
    return row


def _is(value: object, hint: Any) -> bool:
    if get_origin(hint) is dict:
        return isinstance(value, dict)
    kinds = get_args(hint) or (hint,)
    # JSON has whole numbers for some that are none.
    allowed = (*kinds, int) if float in kinds else kinds
    return isinstance(value, allowed) and not isinstance(value, bool)


class RowFile:
    """Keeps rows in a file of JSON lines; a line that a kill cut short is dropped.

    Args:
        path: The file, made with the first row.

    Raises:
        ConfigError: A line is no row.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._rows: dict[str, Row] = {}
        if path.exists():
            self._read()

    def get(self, key: str) -> Row | None:
        """Returns the row of a run, or None."""
        return self._rows.get(key)

    def add(self, row: Row) -> None:
        """Appends a row, on disk when this returns."""
        with self._path.open("ab") as file:
            file.write(json_bytes(asdict(row)) + b"\n")
            file.flush()
            os.fsync(file.fileno())
        self._rows[row.key] = row

    def _read(self) -> None:
        data = self._path.read_bytes()
        whole = data[: data.rfind(b"\n") + 1]
        for number, line in enumerate(whole.splitlines(), start=1):
            try:
                row = _read_row(json.loads(line))
            except (ValueError, TypeError, AttributeError, RecursionError) as error:
                message = f"line {number} of {self._path} is damaged: {line[:60]!r}"
                raise ConfigError(message, hint="remove the line; its run is then done again") from error
            self._rows[row.key] = row
        if len(whole) < len(data):
            os.truncate(self._path, len(whole))

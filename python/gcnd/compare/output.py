"""What a comparison leaves behind for other programs: a CSV table of rows, and JSON with means and conditions."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from io import StringIO
from pathlib import Path
from typing import Any

from gcnd.compare.rows import Row, json_bytes
from gcnd.compare.summary import Line
from gcnd.formats.atomic import write_atomic

__all__ = ["write_csv", "write_json"]


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Writes a line for each row, with a head; what is not known is empty, settings are JSON.

    Args:
        path: File to write.
        rows: Of a comparison, those of `gcnd.compare.summary.with_best` included.
    """
    text = StringIO()
    table = csv.DictWriter(text, [field.name for field in fields(Row)], lineterminator="\n")
    table.writeheader()
    for row in rows:
        table.writerow({**asdict(row), "settings": json.dumps(row.settings)})
    write_atomic(path, text.getvalue())


def write_json(path: Path, about: Mapping[str, Any], rows: Sequence[Row], lines: Sequence[Line]) -> None:
    """Writes conditions, every row and every mean.

    Args:
        path: File to write.
        about: Versions, hardware and options of the run.
        rows: See `write_csv`.
        lines: Of `gcnd.compare.summary.summarise`.
    """
    whole = {
        "about": dict(about),
        "rows": [asdict(row) for row in rows],
        "summary": [asdict(line) for line in lines],
    }
    write_atomic(path, json_bytes(whole, indent=1))

"""Writing a file whole or not at all."""

from __future__ import annotations

import io
import os
import secrets
import shutil
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["write_atomic", "write_atomic_npz"]


def write_atomic(path: str | os.PathLike[str], data: bytes) -> None:
    """Writes `data` to `path` so that no reader ever sees part of it.

    The bytes go to a temporary file in the same folder, which then takes the name's place in one step; on
    any failure the temporary file is removed and what stood at `path` stays. A symbolic link is followed,
    and an existing file's permissions are kept.

    Args:
        path: Where to write.
        data: What to write.

    Raises:
        OSError: If the folder cannot be written to or is full.
    """
    target = Path(os.path.realpath(path))
    partial = target.with_name(f".{target.name[:200]}.{secrets.token_hex(6)}.tmp")
    # os.open and not tempfile: the new file must get the permissions that the umask gives any other.
    descriptor = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        if target.exists():
            shutil.copymode(target, partial)
        os.replace(partial, target)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def write_atomic_npz(path: str | os.PathLike[str], **arrays: Any) -> None:
    """Writes named arrays to an ``.npz`` file as `write_atomic` writes bytes.

    Args:
        path: Where to write.
        arrays: What to write, by name.

    Raises:
        OSError: If the folder cannot be written to or is full.

    Example:
        >>> write_atomic_npz("shape.npz", faces=np.zeros((1, 3)))  # doctest: +SKIP
    """
    data = io.BytesIO()
    np.savez(data, **arrays)
    write_atomic(path, data.getvalue())

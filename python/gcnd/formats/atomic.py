"""Writing a file whole or not at all, and reading one that may not be whole."""

from __future__ import annotations

import errno
import io
import os
import secrets
import shutil
import socket
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.lib.npyio import NpzFile
from numpy.typing import NDArray

from gcnd.errors import GcndError

__all__ = [
    "encoded",
    "read_npz",
    "replacing",
    "write_atomic",
    "write_atomic_npz",
    "write_hint",
    "write_or_tell",
]

_DAMAGED = (OSError, ValueError, KeyError, EOFError, RuntimeError, MemoryError, BadZipFile, zlib.error)
"""What reading an ``.npz`` file raises that is cut short, overwritten or of something else."""

_HOST = "".join(letter if letter.isalnum() else "-" for letter in socket.gethostname())[:40]

_HINTS = {
    errno.ENOSPC: "free some space, or write elsewhere; what stood there is as it was",
    errno.EDQUOT: "your quota is used up: free some space, or write elsewhere",
    errno.EFBIG: "the file is larger than this system or its limits allow; write elsewhere",
    errno.EROFS: "it is mounted read-only: write elsewhere",
    errno.EACCES: "choose another folder or name",
    errno.EPERM: "choose another folder or name",
    errno.ENAMETOOLONG: "choose a shorter name or folder",
}


def write_hint(error: OSError) -> str | None:
    """Returns what to do about a failed write, where that is known.

    Example:
        >>> write_hint(OSError(errno.EROFS, "Read-only file system"))
        'it is mounted read-only: write elsewhere'
    """
    return _HINTS.get(error.errno or 0)


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Gives the name of a file to write, which takes the place of ``path`` in one step when all went well.

    On any failure the file is removed and what stood at `path` stays. What a kill left of an earlier write to `path` is
    removed. A symbolic link is followed, and an existing file's permissions are kept.

    Args:
        path: Where the whole file will be.

    Yields:
        A name in the same folder, hidden, at which there is no file.

    Raises:
        OSError: If the folder cannot be written to or is full, or what stands there is no file.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        raise OSError(errno.EINVAL, "a folder, a device or a pipe, which no file replaces", str(path))
    # Names have at most 255 bytes.
    prefix = f".{os.fsencode(target.name)[:120].decode(errors='ignore')}.{_HOST}."
    _remove_abandoned(target.parent, prefix)
    partial = target.with_name(f"{prefix}{os.getpid()}.{secrets.token_hex(6)}.tmp")
    try:
        yield partial
        if target.exists():
            shutil.copymode(target, partial)
        os.replace(partial, target)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def _remove_abandoned(folder: Path, prefix: str) -> None:
    """Removes what processes of this machine that are no more have left half-written."""
    if os.name != "posix":
        return
    for name in os.listdir(folder):
        pid = name.removeprefix(prefix).partition(".")[0]
        if not (name.startswith(prefix) and name.endswith(".tmp") and pid.isdecimal()):
            continue
        try:
            os.kill(int(pid), 0)
        except (ProcessLookupError, OverflowError):
            (folder / name).unlink(missing_ok=True)
        except PermissionError:
            continue  # it runs, as somebody else


def encoded(text: str) -> bytes:
    r"""Returns text in UTF-8; what is none, as a byte of a file's name that is not UTF-8, is written as ``\udcNN``.

    Example:
        >>> encoded("b\udcff.ply")
        b'b\\udcff.ply'
    """
    return text.encode("utf-8", "backslashreplace")


def write_atomic(path: str | os.PathLike[str], data: bytes | str) -> None:
    """Writes `data` to `path` so that no reader ever sees part of it.

    The bytes go to a temporary file in the same folder, which then takes the name's place in one step; see `replacing`.

    Args:
        path: Where to write.
        data: What to write; text as `encoded` gives it.

    Raises:
        OSError: If the folder cannot be written to or is full.
    """
    whole = encoded(data) if isinstance(data, str) else data
    with replacing(path) as partial, partial.open("xb") as file:
        file.write(whole)
        file.flush()
        os.fsync(file.fileno())


def write_or_tell(path: str | os.PathLike[str], data: bytes | str) -> None:
    """Writes as `write_atomic` does; a failure says which file, why and what to do.

    Args:
        path: Where to write.
        data: What to write; text as `encoded` gives it.

    Raises:
        GcndError: The file cannot be written.
    """
    try:
        write_atomic(path, data)
    except OSError as error:
        raise GcndError(f"cannot write {path}: {error.strerror or error}", write_hint(error)) from error


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


def read_npz(path: str | os.PathLike[str], *names: str) -> dict[str, NDArray[Any]] | None:
    """Reads the arrays of an ``.npz`` file.

    Args:
        path: What to read.
        names: Arrays that it must hold.

    Returns:
        All its arrays by name; None if there is no such file, it is damaged, or one of ``names`` is not in it.

    Example:
        >>> read_npz("no-such-file.npz") is None
        True
    """
    try:
        with open(path, "rb") as file, NpzFile(file, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive}
    except _DAMAGED:
        return None
    return arrays if arrays.keys() >= set(names) else None

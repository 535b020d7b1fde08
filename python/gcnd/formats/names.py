"""Names that no file can have, told before the system is asked for one."""

from __future__ import annotations

import errno
from pathlib import Path

from gcnd.errors import GcndError, MeshError
from gcnd.formats.atomic import write_hint

__all__ = ["check_name"]


def check_name(path: Path, error: type[GcndError] = MeshError) -> None:
    """Checks that the system can look for a file of that name, whether it is there or not.

    Args:
        path: The name.
        error: What is raised.

    Raises:
        GcndError: It has a character that no name may have, it is too long, or its folder is closed to this user.

    Example:
        >>> check_name(Path("no such file.ply"))
        >>> check_name(Path("a\\0b.ply"))
        Traceback (most recent call last):
        gcnd.errors.MeshError: 'a\\x00b.ply' is no name of a file
    """
    try:
        path.lstat()
    except ValueError:
        hint = "it has a character that no name may have"
        raise error(f"{str(path)!r} is no name of a file", hint) from None
    except OSError as refused:
        if refused.errno in (errno.ENAMETOOLONG, errno.EACCES):
            raise error(f"{path}: {refused.strerror}", write_hint(refused)) from refused

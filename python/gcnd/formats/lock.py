"""One program at a time in a folder that a run writes to."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from gcnd.errors import ConfigError

__all__ = ["only_writer"]

_NAME = ".lock"


@contextmanager
def only_writer(folder: Path) -> Iterator[None]:
    """Hold a folder, which is made if missing, so that a second run in it is refused.

    The system lets go of it when the process ends, however it ends; the file ``.lock`` may stay and says nothing. A
    folder that was made here goes again, without those above it, where what is done fails before it writes anything.

    Raises:
        ConfigError: Another run holds the folder, or a file cannot be written to it.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as name, only_writer(Path(name)):
        ...     pass
    """
    lock, is_new = FileLock(folder / _NAME, timeout=0), not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout as error:
        raise ConfigError(
            f"another run is writing to {folder}", hint="wait until it has ended, or choose another folder"
        ) from error
    except OSError as error:
        raise ConfigError(
            f"cannot write to {folder}: {error.strerror}", hint="choose another folder"
        ) from error
    try:
        yield
    except BaseException:
        # Before others may have it; what cannot be removed stays, and what failed is told.
        with suppress(OSError):
            if is_new and [path.name for path in folder.iterdir()] in ([_NAME], []):
                (folder / _NAME).unlink(missing_ok=True)
                folder.rmdir()
        raise
    finally:
        lock.release()

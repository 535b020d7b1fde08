"""One run of gcnd beside Blender's own work: in a thread, or by the `gcnd` command. Needs no Blender."""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import tempfile
import threading
from abc import ABC, abstractmethod
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .arrays import Triangles, read_positions, write_ply
from .errors import Failure, Stopped

__all__ = ["CommandRun", "PythonRun", "Run", "find_command", "has_gcnd", "told_error"]

NO_WINDOW = getattr(subprocess, "CREATE_NO_WINDOW", 0)
"""On Windows a program started from one without a console would open one."""

_STAGE = re.compile(r"(?P<stage>.+) \((?P<percent>\d+)% done\)")


class Run(ABC):
    """A run of gcnd on one mesh, in a thread of its own that never touches Blender.

    Args:
        mesh: What to denoise; not changed.
        preset: Name of the weights.

    Attributes:
        fraction: How much is done, in [0, 1].
        stage: What is being done.
    """

    def __init__(self, mesh: Triangles, preset: str) -> None:
        self.mesh, self.preset = mesh, preset
        self.fraction, self.stage = 0.0, "starting"
        self._stopping = threading.Event()
        self._result: NDArray[np.float32] | None = None
        self._error: BaseException | None = None
        # Not a daemon: temporary files go before Blender does.
        self._thread = threading.Thread(target=self._run, name="gcnd")

    def start(self) -> None:
        """Begins the work."""
        self._thread.start()

    def stop(self) -> None:
        """Asks the run to end soon; it then ends with ``Stopped``."""
        self._stopping.set()

    def is_done(self) -> bool:
        """Says whether ``result`` returns at once."""
        return not self._thread.is_alive()

    def wait(self) -> None:
        """Waits for the end."""
        self._thread.join()

    def result(self) -> NDArray[np.float32]:
        """Waits for the end and returns the denoised positions (V, 3).

        Raises:
            Failure: The mesh or the settings do not fit, or gcnd could not be run.
            Stopped: The run was stopped.
        """
        self.wait()
        if self._error is not None:
            raise self._error
        assert self._result is not None
        return self._result

    def _run(self) -> None:
        try:
            result = self._denoised()
            if self._stopping.is_set():
                raise Stopped
            if result.shape != self.mesh.positions.shape or not np.isfinite(result).all():
                raise Failure("gcnd returned positions that do not fit the mesh")
            self._result = result
        except BaseException as error:
            # Carried to whoever asks for the result.
            self._error = error

    @abstractmethod
    def _denoised(self) -> NDArray[np.float32]:
        """Does the work."""


class PythonRun(Run):
    """Runs gcnd in Blender's own Python."""

    def _denoised(self) -> NDArray[np.float32]:
        try:
            import gcnd
        except ImportError as error:
            raise Failure(
                f"gcnd cannot be imported: {error}",
                "install it into Blender's Python again, or choose the command in the preferences",
            ) from error
        try:
            positions, _ = gcnd.denoise(tuple(self.mesh), preset=self.preset, progress=self._told)
        except gcnd.Cancelled as cancelled:
            raise Stopped from cancelled
        except gcnd.GcndError as error:
            raise Failure(str(error), error.hint) from error
        return np.asarray(positions, dtype=np.float32)

    def _told(self, fraction: float, stage: str) -> bool:
        self.fraction, self.stage = fraction, stage
        return not self._stopping.is_set()


class CommandRun(Run):
    """Runs the `gcnd` command on a file in a temporary folder, which goes when the run ends.

    Args:
        mesh: What to denoise; not changed.
        preset: Name of the weights.
        command: The program and what comes before its own arguments.
    """

    def __init__(self, mesh: Triangles, preset: str, command: tuple[str, ...]) -> None:
        super().__init__(mesh, preset)
        self._command = command
        self._lock = threading.Lock()
        self._process: subprocess.Popen[str] | None = None

    def stop(self) -> None:
        """Ends the command."""
        super().stop()
        with self._lock:
            if self._process is not None:
                self._process.terminate()

    def _denoised(self) -> NDArray[np.float32]:
        with tempfile.TemporaryDirectory(prefix="gcnd_") as folder:
            source, target = Path(folder, "in.ply"), Path(folder, "out.ply")
            write_ply(source, self.mesh)
            code, lines = self._ran("denoise", str(source), str(target), "--preset", self.preset)
            if self._stopping.is_set():
                raise Stopped
            if code != 0 or not target.exists():
                raise told_error(lines, code)
            return read_positions(target, source)

    def _ran(self, *arguments: str) -> tuple[int, list[str]]:
        """Runs the command to its end; returns its exit code and the lines it wrote for people."""
        with self._lock:
            if self._stopping.is_set():
                raise Stopped
            try:
                self._process = subprocess.Popen(
                    [*self._command, *arguments],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.PIPE,
                    encoding="utf-8",
                    errors="replace",
                    creationflags=NO_WINDOW,
                )
            except OSError as error:
                raise _not_started(self._command[0], error) from error
        with self._process as process:
            assert process.stderr is not None
            lines = [line.rstrip() for line in process.stderr if not self._told(line.rstrip())]
        return process.returncode, lines

    def _told(self, line: str) -> bool:
        """Takes a line that says how far the command has come; says whether it was one."""
        match = _STAGE.fullmatch(line)
        if match:
            self.fraction, self.stage = int(match["percent"]) / 100, match["stage"]
        return match is not None


def told_error(lines: list[str], code: int) -> Failure:
    """Makes an error of what the command wrote: `error: …`, an empty line, `hint: …`."""
    message = next((line[7:] for line in lines if line.startswith("error: ")), None)
    hint = next((line[6:] for line in lines if line.startswith("hint: ")), None)
    if message is None:
        said = " ".join(line for line in lines if line)[-300:]
        message = f"the gcnd command ended with code {code}" + (f": {said}" if said else "")
    return Failure(message, hint)


def has_gcnd() -> bool:
    """Says whether this Python has gcnd; does not import it."""
    return importlib.util.find_spec("gcnd") is not None


def find_command(name: str) -> tuple[str, ...]:
    """Finds the `gcnd` program.

    Args:
        name: A name on the search path, or a path.

    Returns:
        What `CommandRun` takes as its command.

    Raises:
        Failure: There is none.
    """
    path = shutil.which(str(Path(name).expanduser())) if name else None
    if path is None:
        raise Failure(
            f"There is no program {name!r}",
            "install gcnd and set the path of its program in the add-on's preferences",
        )
    return (path,)


def _not_started(program: str, error: OSError) -> Failure:
    return Failure(
        f"{program} cannot be started: {error.strerror or error}", "set its path in the preferences"
    )

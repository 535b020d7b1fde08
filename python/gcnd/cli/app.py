"""The `gcnd` program: its commands, its version, and how every error is told."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Sequence
from typing import Annotated, NoReturn, TextIO

import typer

from gcnd.cli import compare, denoise, evaluate, info, models, noise, train, train_report, view
from gcnd.cli.caution import telling_warnings
from gcnd.cli.interrupt import EXIT_INTERRUPTED, EXIT_SIGNAL, Ended, exit_now, noticing_ctrl_c, own_process
from gcnd.errors import GcndError

__all__ = ["app", "main", "program"]

app = typer.Typer(
    name="gcnd",
    help="Remove noise from triangle meshes and keep their features.",
    context_settings={"help_option_names": ["-h", "--help"]},
    add_completion=False,
    pretty_exceptions_enable=False,
)
# A new command is one new module and one line here.
app.command("denoise")(denoise.run)
app.command("noise")(noise.run)
app.command("compare")(compare.run)
app.command("evaluate")(evaluate.run)
app.command("info")(info.run)
app.command("models")(models.run)
app.command("train")(train.run)
app.command("train-report")(train_report.run)
app.command("view")(view.run)

_EXIT_ERROR = 1


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line.

    Data goes to stdout, everything else to stderr. An error is told as `error: …`, a blank line and
    `hint: …`, never as a traceback; a warning as `warning: …`.

    Args:
        argv: The arguments without the program's name; by default those of the process.

    Returns:
        The exit code: 0; 1 for an error in the input, files or parameters, and, without a word, when the
        reader of stdout is gone; 2 for a wrong command line; 130 when interrupted, and 128 plus the number of
        another signal that ended a comparison or a run of `gcnd denoise`.
    """
    try:
        try:
            with noticing_ctrl_c(), telling_warnings():
                app(args=None if argv is None else list(argv), prog_name="gcnd")
        except SystemExit as done:
            sys.stdout.flush()
            return done.code if isinstance(done.code, int) else int(done.code is not None)
    except BrokenPipeError:
        # Python flushes stdout once more at exit; that must not complain either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _EXIT_ERROR
    except GcndError as error:
        return _tell(str(error), error.hint)
    except OSError as error:
        from gcnd.formats.atomic import write_hint

        names = " -> ".join(str(name) for name in (error.filename, error.filename2) if name is not None)
        told = f"{names}: {error.strerror}" if names else str(error.strerror or error)
        return _tell(told, write_hint(error))
    except MemoryError:
        return _tell("out of memory", "close other programs, or use a machine with more memory")
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except Ended as ended:
        return ended.exit_code
    return 0


def program() -> NoReturn:
    """Runs the command line as a process of its own, which Ctrl-C ends at once."""
    own_process()
    # A daemon may have closed them; there is nobody to tell anything then.
    sys.stdout, sys.stderr = sys.stdout or _nowhere(), sys.stderr or _nowhere()
    if isinstance(sys.stdout, io.TextIOWrapper):
        # As of stderr: a name that the terminal has no letters for is no reason to fail.
        sys.stdout.reconfigure(errors="backslashreplace")
    code = main()
    if code > EXIT_SIGNAL:
        exit_now(code)
    sys.exit(code)


def _nowhere() -> TextIO:
    return open(os.devnull, "w", encoding="utf-8")


def _tell(message: str, hint: str | None = None) -> int:
    print(f"error: {message}", file=sys.stderr)
    if hint:
        print(f"\nhint: {hint}", file=sys.stderr)
    return _EXIT_ERROR


def _print_version(wanted: bool) -> None:
    if not wanted:
        return
    from importlib.metadata import PackageNotFoundError, version

    try:
        print(f"gcnd {version('gcnd')}")
    except PackageNotFoundError:
        print("gcnd (not installed)")
    raise typer.Exit


@app.callback(invoke_without_command=True)
def _program(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Remove noise from triangle meshes and keep their features."""
    if context.invoked_subcommand is None:
        print(context.get_help())

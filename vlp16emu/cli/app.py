"""The program: its verbs, and the one place where errors become lines and exit codes."""

import errno
import gc
import io
import logging
import os
import signal
import sys
import threading
import warnings
from collections.abc import Collection, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from vlp16emu.cli.printer import INTERRUPTED
from vlp16emu.cli.terminal import ENDINGS
from vlp16emu.cli.verb import command
from vlp16emu.cores import check_numba_threads
from vlp16emu.doors import DOORS, door, has_door
from vlp16emu.errors import InputError, Vlp16emuError, one_line, printable
from vlp16emu.output import is_ending

_CLEANUP_S = 0.8  # time that an interrupted command has to remove unfinished output

_SHOWN_NAME = 60  # characters of a name that is too long for a file

_WRITE_ERRORS = errno.ENOSPC, errno.EFBIG, errno.EDQUOT, errno.EIO, errno.EPIPE
"""Errors of a write to standard output; errors of files carry their names, as `output.py` opens them."""

_LIMIT_TEXTS = "can't start new thread", "can't allocate", "failed to map segment"
"""Texts of Python's and the loader's errors where memory or threads are limited, as in containers."""

_was_interrupted = threading.Event()


def program(names: Collection[str]) -> typer.Typer:
    """Return the program with the verbs of some names.

    Raises InputError if there is one name, and its part of the package is not installed.
    """
    app = typer.Typer(
        add_completion=False,
        rich_markup_mode=None,  # plain text reads well in every terminal, file and pipe
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    )
    app.callback(invoke_without_command=True)(_root)
    examples = Path(__file__).with_name("examples.txt").read_text(encoding="utf-8").splitlines()
    for name in names:
        try:
            verb = door(name, "verbs")
        except InputError:  # a part that is not installed; the help leaves it out
            if len(names) == 1:
                raise
            continue
        lines = "\n".join(f"  vlp16emu {line}" for line in examples if line.partition(" ")[0] == name)
        epilog = f"Examples:\n\n\b\n{lines}" if lines else None
        app.command(name, epilog=epilog)(command(verb))
    return app


def _root(
    context: typer.Context,
    *,
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    """Emulate a Velodyne VLP-16 that is carried through synthetic forests.

    Every packet has byte for byte the format of the sensor: `record` writes a pcap file, `stream` sends over
    UDP in real time.
    """
    if version:
        from importlib.metadata import version as version_of

        print(f"vlp16emu {version_of('vlp16emu')}")
    elif context.invoked_subcommand is None:
        print(context.get_help())


def run(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit code.

    The code is 0 if all is done, 1 if it failed or rules are broken, 2 for bad input, and 130 if it was
    interrupted.
    """
    try:
        check_numba_threads()
        verb = next((word for word in arguments if not word.startswith("-")), None)
        is_verb = verb is not None and has_door(verb, "verbs")
        app = program([verb] if verb and is_verb else DOORS["verbs"])  # the others need not be loaded
        code = app(arguments, prog_name="vlp16emu", standalone_mode=False)
        return code if isinstance(code, int) else 0  # a verb of another package may return anything
    except Vlp16emuError as error:
        if _was_interrupted.is_set():  # a library has made another error of the interrupt
            return INTERRUPTED
        _print_error(str(error))
        return error.exit_code
    except typer.TyperException as error:  # the command line itself is wrong
        context = getattr(error, "ctx", None)
        words = " ".join(error.format_message().rstrip(".").splitlines())
        message = one_line(words)  # it repeats the command line
        _print_error(f"{message}; see `{context.command_path if context else 'vlp16emu'} --help`")
        return 2
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        name = str(error.filename)
        _print_error(f"{name[:_SHOWN_NAME]}...: a name of {len(name)} characters; expected a path of a file")
        return 2
    except MemoryError as error:
        _print_error(f"out of memory: {error}" if str(error) else "out of memory")
        return 1
    except (RuntimeError, ImportError) as error:
        if not any(text in str(error) for text in _LIMIT_TEXTS):
            raise
        _print_error(f"out of memory or threads: {error}")
        return 1
    except (KeyboardInterrupt, CancelledError):  # the latter if a run was stopped before its first packet
        return INTERRUPTED


def main() -> None:
    """Run the command line of this process and exit."""
    code = None
    try:
        for number in ENDINGS:  # first, so that a signal in the lines below leaves no traceback
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, _interrupt)
        _set_up()
        sys.unraisablehook = _hide_interrupt
        for output in (sys.stdout, sys.stderr):
            # File names may hold characters that a terminal cannot show.
            if isinstance(output, io.TextIOWrapper):
                output.reconfigure(errors="backslashreplace")
        code = run(sys.argv[1:])
        gc.freeze()  # saves the collection at exit
        print(end="", flush=True)
    except KeyboardInterrupt:  # before the command begins, or after its end
        code = INTERRUPTED
    except Exception as error:
        if _was_interrupted.is_set():  # inside a class definition Python raises another error
            code = INTERRUPTED
        elif isinstance(error, OSError):
            code = _exit_code(error, code)
        else:
            raise
    if code == INTERRUPTED:
        os._exit(code)  # Python would wait for threads whose results are no longer needed
    sys.exit(code)


def _set_up() -> None:
    """Set what holds for the whole process: threads of libraries, memory, standard streams, warnings."""
    # Our own threads do the parallel work; OpenBLAS threads would spin while they wait for products of a few
    # rows.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # searching for them reads all metadata
    gc.set_threshold(500_000)  # libraries bring 300 000 objects, none of them garbage
    for number in range(3):  # a file that a run opens must not take the place of a closed standard stream
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    warnings_on_stderr = logging.StreamHandler()
    warnings_on_stderr.setFormatter(_LineFormatter("warning: %(message)s"))
    logging.basicConfig(handlers=[warnings_on_stderr])
    if not sys.warnoptions:
        # From numpy: the error line that follows says what is wrong.
        warnings.simplefilter("ignore", RuntimeWarning)


class _LineFormatter(logging.Formatter):
    """A format of warnings that escapes control characters, as they quote names of files."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # logging's name
        return printable(super().formatMessage(record))


def _exit_code(error: OSError, code: int | None) -> int:
    """Report an unexpected OSError and return the exit code.

    `code` is the exit code of the verb, None if it has not ended.
    """
    try:
        print(end="", flush=True)
        is_of_write = error.filename is None and error.errno in _WRITE_ERRORS
        if is_of_write:  # for a long text nothing is left to flush
            raise error
    except OSError:  # standard output cannot be written
        # The rest of the output is discarded: Python would write it at exit, and report the error again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    else:
        where = error.filename or ("the current folder" if error.errno == errno.ENOENT else "the system")
        _print_error(f"{where}: {error.strerror or error}")
        return 1
    if is_ending.is_set():  # its terminal is gone
        return INTERRUPTED
    if code or isinstance(error, BrokenPipeError):  # the reason is printed, or the reader closed the pipe
        return code or 1
    _print_error(f"standard output: {error.strerror}")
    return 1


def _interrupt(_signal: int, _frame: object) -> None:
    """End the command within a second; the next signal ends the process at once."""
    _was_interrupted.set()
    is_ending.set()
    for number in ENDINGS:
        signal.signal(number, lambda *_: os._exit(INTERRUPTED))
    timer = threading.Timer(_CLEANUP_S, os._exit, [INTERRUPTED])
    timer.daemon = True
    timer.start()
    raise KeyboardInterrupt


def _hide_interrupt(error: "sys.UnraisableHookArgs") -> None:
    """Hide the KeyboardInterrupt of a callback or `__del__` in a library, which cannot propagate it."""
    if not _was_interrupted.is_set():
        sys.__unraisablehook__(error)


def _print_error(message: str) -> None:
    with suppress(OSError, AttributeError):  # standard error may be closed
        print(f"error: {printable(' '.join(message.splitlines()))}", file=sys.stderr)

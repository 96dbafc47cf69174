"""Functions shared by tools: options, the program's command line, tables, environments of other programs."""

import argparse
import io
import os
import subprocess
import sys
import time
from collections.abc import Container, Iterable, Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import NamedTuple

VLP16EMU = [sys.executable, "-m", "vlp16emu"]


def options(
    doc: str, *, scene: str = "", duration_s: float = 0.0, venv: str = "", settings: bool = False
) -> argparse.ArgumentParser:
    """Return the parser of a tool with its docstring and shared options: scene, duration, venv, settings."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    if scene:
        parser.add_argument("scene", nargs="?", default=scene)
    if duration_s:
        parser.add_argument("--duration", type=float, default=duration_s, help="seconds of each run")
    if venv:
        parser.add_argument("--venv", type=Path, help=f"virtual environment with {venv}; made if missing")
    if settings:
        key = "SECTION.KEY=VALUE"
        parser.add_argument("--set", action="append", default=[], metavar=key, help="scene setting")
    return parser


def arguments(parser: argparse.ArgumentParser, **shortest: object) -> argparse.Namespace:
    """Parse the command line; `--shortest` sets these values, for a run that shows that the tool works."""
    parser.add_argument("--shortest", action="store_true", help="run for seconds, to see that it works")
    wanted = parser.parse_args()
    if wanted.shortest:
        vars(wanted).update(shortest)
    return wanted


def program(*words: object) -> str:
    """Run a command line of vlp16emu in this process, and return what it prints.

    Raises
    ------
    SystemExit
        if its exit code is not 0
    """
    from vlp16emu.cli.app import run

    out = io.StringIO()
    with redirect_stdout(out):
        code = run([*map(str, words)])
    if code:
        raise SystemExit(code)
    return out.getvalue()


class Took(NamedTuple):
    """Resources of a program."""

    wall_s: float
    cpu_s: float
    peak_mb: float


def took(command: Sequence[str | Path], *, codes: Container[int] = (0,), **variables: str) -> Took:
    """Run a program without what it prints but errors, and return what it took.

    Parameters
    ----------
    codes : exit codes that are no failure
    variables : of its environment, beside those of this process

    Raises
    ------
    SystemExit
        if its exit code is another one
    """
    began_s = time.perf_counter()
    environment = os.environ | variables
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, env=environment) as process:
        _, status, used = os.wait4(process.pid, 0)  # memory of this child alone
        process.returncode = os.waitstatus_to_exitcode(status)
    wall_s = time.perf_counter() - began_s
    if process.returncode not in codes:
        raise SystemExit(f"{' '.join(map(str, command))}: exit code {process.returncode}")
    return Took(wall_s, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024 / 1e6)


def print_row(*cells: object) -> None:
    """Print a row of a table in Markdown at once."""
    print("| " + " | ".join(map(str, cells)) + " |", flush=True)


def print_head(*names: str, left: int = 1) -> None:
    """Print the head of a table in Markdown; columns after the first `left` ones are numbers."""
    print_row(*names)
    print("|" + "---|" * left + "---:|" * (len(names) - left), flush=True)


def set_words(settings: Iterable[str]) -> list[str]:
    """Return the words of a command line for settings of a scene."""
    return [word for setting in settings for word in ("--set", setting)]


def python_of(venv: Path, *packages: str) -> Path:
    """Return the Python of a virtual environment, which is made with `packages` if it does not exist."""
    python = venv / "bin" / "python"
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", str(venv)], check=True)
        subprocess.run([str(python), "-m", "pip", "install", "-qq", *packages], check=True)
    return python

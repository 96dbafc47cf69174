"""What several tools do: options, the program's own command line, and programs of others in an environment of their own."""

import argparse
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

VLP16EMU = [sys.executable, "-m", "vlp16emu"]


def options(
    doc: str, *, scene: str = "", duration_s: float = 0.0, venv: str = "", settings: bool = False
) -> argparse.ArgumentParser:
    """Parser of a tool with this docstring, and with what several tools take: a scene, `--duration`, `--venv` and `--set`."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    if scene:
        parser.add_argument("scene", nargs="?", default=scene)
    if duration_s:
        parser.add_argument("--duration", type=float, default=duration_s, help="of each walk, in seconds")
    if venv:
        parser.add_argument("--venv", type=Path, help=f"where {venv} is or will be installed")
    if settings:
        parser.add_argument("--set", action="append", default=[], metavar="SECTION.KEY=VALUE", help="of the scene")
    return parser


def set_words(settings: Iterable[str]) -> list[str]:
    """Words of a command line for settings of a scene."""
    return [word for setting in settings for word in ("--set", setting)]


def python_of(venv: Path, *packages: str) -> Path:
    """Python of a virtual environment, which is made with `packages` if there is none."""
    python = venv / "bin" / "python"
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", str(venv)], check=True)
        subprocess.run([str(python), "-m", "pip", "install", "-qq", *packages], check=True)
    return python

"""Programs of others, in a virtual environment of their own."""

import subprocess
import sys
from pathlib import Path


def python_of(venv: Path, *packages: str) -> Path:
    """Python of a virtual environment, which is made with `packages` where there is none."""
    python = venv / "bin" / "python"
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", str(venv)], check=True)
        subprocess.run([str(python), "-m", "pip", "install", "-qq", *packages], check=True)
    return python

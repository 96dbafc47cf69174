"""Tables of sensor models, from `protocol/models`, where each constant has its source."""

import tomllib
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any


def _folder() -> Path:
    """Return the folder of the tables: beside the package in a checkout, inside it in an installation."""
    package = Path(str(resources.files("vlp16emu")))
    checkout = package.parent / "protocol"
    is_checkout = (package.parent / "pyproject.toml").is_file()
    return (checkout if is_checkout else package / "protocol") / "models"


_FOLDER = _folder()
MODEL_NAMES = tuple(sorted(path.stem for path in _FOLDER.glob("*.toml")))
"""Names of the models in a scene: those of the tables."""


@cache
def model_table(name: str) -> dict[str, Any]:
    """Return the table of a model by its name in a scene, for instance `vlp-32c`; read-only, as it is shared.

    Its keys are explained in `protocol/models/README.md`.
    """
    return tomllib.loads((_FOLDER / f"{name}.toml").read_text(encoding="utf-8"))

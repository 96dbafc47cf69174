"""Values of parameters in configuration files of any syntax: YAML, JSON, Lua, shell and launch files."""

import re
from collections.abc import Mapping
from typing import NamedTuple

_SET = re.compile(r"(?P<name>[A-Za-z][\w/.]*)(?::=|: |=)(?P<value>\[[^\]]*\]|/[\w/]+|-?\d[-+.e\d]*)")
"""Parameter and value in the text of a need: `mapping/extrinsic_T: [0.0, 0.0, 0.1]`, `imu_topic:=/imu`."""
_REMARKS = re.compile(r"<!--.*?-->|#.*|^\s*--.*", re.MULTILINE)
_NUMBER = re.compile(r"-?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
_TOLERANCE = 0.03  # relative, of rates and durations
_POSE_TOLERANCE = 2e-3  # m, and elements of rotations: 0.1 deg


class Parameter(NamedTuple):
    """A parameter in a file."""

    file: str
    name: str
    value: str
    is_right: bool  # the value is the wanted one

    def __str__(self) -> str:
        return f"{self.file} has {self.name}: {self.value}"


def parameters_held(needs: str, texts: Mapping[str, str]) -> list[Parameter]:
    """Return the parameters that a need sets and that configuration files (text by name) hold."""
    remedy = needs.partition("; ")[0]
    wanted = {found["name"]: found["value"] for found in _SET.finditer(remedy)}
    return [
        Parameter(file, name, value, _is_equal(value, wanted[name]))
        for file, text in texts.items()
        for name in wanted
        for value in _values(_REMARKS.sub("", text), name)
    ]


def _values(text: str, name: str) -> list[str]:
    """Return the values of a parameter in a text, with single blanks."""
    *_, parent, last = ["", *re.split(r"[/.]", name)]
    key = re.escape(last)
    if len(last) == 1:  # t and R, as parameters or as keys below their parent
        key = rf"{re.escape(parent)}(?:/|:\s*)(?:\w:\s*\[[^\]]*\]\s*)*{key}"
    form = rf"(?<!\w){key}[\"']?\s*(?::=|[:=]|value=)\s*[\"']?(\[[^\]]*\]|[^\s,\"'<>]+)"
    return [" ".join(found.split()) for found in re.findall(form, text)]


def _is_equal(value: str, wanted: str) -> bool:
    if wanted.startswith("/"):
        return value == wanted
    numbers = [float(number) for number in _NUMBER.findall(value)]
    wanted_numbers = [float(number) for number in _NUMBER.findall(wanted)]
    if len(numbers) != len(wanted_numbers):
        return False
    return all(
        abs(number - right) <= (_POSE_TOLERANCE if wanted.startswith("[") else _TOLERANCE * abs(right))
        for number, right in zip(numbers, wanted_numbers, strict=True)
    )

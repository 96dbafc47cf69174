"""Table of SLAM programs, `programs.toml`, and their configurations for a rig, in the format of each program."""

import json
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple, Self
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from vlp16emu.elementary import inverse, matmul
from vlp16emu.errors import InputError, OutputError
from vlp16emu.extras.truth.truth import given_mount
from vlp16emu.output import OutputFile, final_name
from vlp16emu.types import F8

_COLUMNS = 1_080_000
"""Columns per revolution times rpm: 1800 at 600 rpm, as in LIO-SAM and LeGO-LOAM (config/params.yaml,
utility.h)."""

Leaves = list[
    tuple[str, Any, str]
]  # key, value and a remark, which is empty if the value is the program's default


class Value(NamedTuple):
    """A value of a configuration: path in the file, our value, the program's default, reason of a difference, source."""

    key: str
    value: Any  # a text {name} refers to a value of the rig
    default: Any = None
    why: str = ""
    source: str = ""


class ConfigFile(NamedTuple):
    """A file of a configuration; its suffix gives the format, and a .launch file includes a launch file of a package."""

    name: str
    values: tuple[Value, ...]
    root: str = ""  # parent path of all keys
    include: str = ""


class Program(NamedTuple):
    """A SLAM program: repository, sources read; in Markdown its start command, and its compile-time constants."""

    name: str
    repository: str
    read: list[str]
    start: str
    compiled: str
    files: list[ConfigFile]
    needs: Mapping[str, str]  # by rule of `fitness`: value to set, and consequence otherwise
    rest_s: float = 0.0  # required time at rest at the start


@cache
def programs() -> Mapping[str, Program]:
    """Return all programs by name, in the order of the table."""
    table = tomllib.loads(files(__package__).joinpath("programs.toml").read_text(encoding="utf-8"))
    for row in table.values():
        row["files"] = [
            ConfigFile(**one | {"values": tuple(Value(*v) for v in one["values"])}) for one in row["files"]
        ]
    return {name: Program(name, **row) for name, row in table.items()}


def chosen(name: str, *, where: str = "--for") -> list[Program]:
    """Return a program by name, or all of them; InputError if there is none."""
    if name != "all" and name not in programs():
        raise InputError(where, f"found {name}", f"{', '.join(programs())} or all")
    return [program for program in programs().values() if name in ("all", program.name)]


@dataclass(frozen=True)
class Rig:
    """Rig of a configuration; the default is the rig of the files in `protocol/slam`."""

    rpm: float = 600.0
    base_T_lidar: F8 | None = None  # (4, 4) extrinsics; None if they are the identity, or change
    base_T_imu: F8 | None = None
    imu: Mapping[str, Any] | None = None  # section of the scene
    lidar_frame: str = "velodyne"

    @classmethod
    def of(cls, rig: Mapping[str, Any], scenario: Mapping[str, Any], frame: str) -> Self:
        """Return the rig of the first unit, with lidar frame `frame`, from `rig.json` and `scenario.json`."""
        imu = given_mount(rig["imu"], "body_T_imu") if "imu" in rig else None
        lidar = given_mount(rig["units"][0], "body_T_sensor")
        return cls(float(scenario["sensor"]["rpm"]), lidar, imu, scenario.get("imu"), frame)

    @property
    def words(self) -> str:
        """Rig in one line."""
        imu = self.imu or {}
        return f"{self.rpm:g} rpm, IMU {imu.get('rate_hz', 200)} Hz{', with attitude' if imu.get('attitude') else ''}"

    def names(self) -> dict[str, Any]:
        """Return the values of the names in the table; None if the rig has no such value."""
        base_T_lidar, base_T_imu = (
            np.eye(4) if T is None else T for T in (self.base_T_lidar, self.base_T_imu)
        )
        imu = self.imu or {}
        poses = {
            ("imu", "lidar"): matmul(inverse(base_T_imu), base_T_lidar),
            ("lidar", "imu"): matmul(inverse(base_T_lidar), base_T_imu),
            ("base", "lidar"): base_T_lidar,
            ("base", "imu"): base_T_imu,
        }
        sizes = {"accel_noise": "accel_noise_m_s2_sqrt_hz", "gyro_noise": "gyro_noise_rad_s_sqrt_hz"}
        sizes |= {"accel_walk": "accel_walk_m_s3_sqrt_hz", "gyro_walk": "gyro_walk_rad_s2_sqrt_hz"}
        return {
            "points": f"/{self.lidar_frame}_points",
            "lidar_frame": self.lidar_frame,
            "imu_with_attitude": "/imu/data" if imu.get("attitude") else "/imu/without_attitude",
            "sweep_hz": round(self.rpm / 60.0),
            "sweep_s": round(60.0 / self.rpm, 9),
            "columns": round(_COLUMNS / self.rpm),
            "imu_s": round(1.0 / imu.get("rate_hz", 200), 9),
            **{name: imu.get(key) or None for name, key in sizes.items()},
            **{key: value for pair, T in poses.items() for key, value in pose_names(*pair, T).items()},
        }


def pose_names(of: str, what: str, T: NDArray[Any]) -> dict[str, list[float]]:
    """Return the pose (4, 4) of frame `what` in frame `of` by the names of the table, in the orders that programs use."""
    from scipy.spatial.transform import Rotation

    place = (T[:3, 3].round(9) + 0.0).tolist()
    turn = (T[:3, :3].round(9) + 0.0).ravel().tolist()
    quaternion = (Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True).round(9) + 0.0).tolist()
    return {
        f"{of}_t_{what}": place,
        f"{of}_R_{what}": turn,
        f"{of}_pose_{what}": quaternion + place,
        f"{of}_tum_{what}": place + quaternion,
    }


def configurations(program: Program, rig: Rig) -> dict[str, str]:
    """Return the files of a configuration, by name."""
    head = f"{program.name} ({program.repository}): {rig.words}.", f"Read in {', '.join(program.read)}."
    lines = {
        file.name: _FORMATS[file.name.rpartition(".")[2]](file, leaves(file, rig), head)
        for file in program.files
    }
    return {name: "\n".join(of) + "\n" for name, of in lines.items()}


@contextmanager
def written_beside(bag: Path, name: str | None, rig: Callable[[], Rig]) -> Iterator[None]:
    """Write the configuration of a program, or of all, beside a bag when the block ends: `walk.lio-sam.yaml`.

    Raises InputError if there is no such program; OutputError if one of the files exists with other values.
    """
    texts = {
        final_name(bag.with_name(f"{bag.stem}.{file}")): text
        for program in (chosen(name) if name is not None else ())
        for file, text in configurations(program, rig()).items()
    }
    for path, text in texts.items():
        if path.exists() and not (
            path.is_file() and path.read_text(encoding="utf-8", errors="replace") == text
        ):
            raise OutputError(str(path), "is there already, with other values", "another name for the bag")
    yield
    for path, text in texts.items():
        with OutputFile(path) as output, output.writing() as file:
            file.write(text.encode())


def leaves(file: ConfigFile, rig: Rig) -> Leaves:
    """Return the values of a file for a rig."""
    names = rig.names()
    found = []
    for key, given, default, why, _ in file.values:
        is_named = isinstance(given, str) and given.startswith("{")
        value = names[given.strip("{}")] if is_named else given
        value = default if value is None else value
        own = (default or "empty") if isinstance(default, str) else as_text(default)
        found.append((key, value, "" if default in (None, value) else f"{why}; its own value is {own}"))
    return found


def _tree(file: ConfigFile, leaves: Leaves) -> dict[str, Any]:
    tree: dict[str, Any] = {}
    for key, value, remark in leaves:
        *path, last = f"{file.root}/{key}".strip("/").split("/")
        place = tree
        for part in path:
            place = place.setdefault(part, {})
        place[last] = (value, remark)
    return tree


def _yaml(file: ConfigFile, leaves: Leaves, head: Sequence[str]) -> Iterator[str]:
    def lines(tree: dict[str, Any], indent: str) -> Iterator[str]:
        for key, value in tree.items():
            if isinstance(value, dict):
                yield f"{indent}{key}:"
                yield from lines(value, indent + "  ")
            else:
                yield f"{indent}{key}: {as_text(value[0])}" + (f"  # {value[1]}" if value[1] else "")

    yield from (f"# {line}" for line in head)
    yield from lines(_tree(file, leaves), "")


def _json_file(file: ConfigFile, leaves: Leaves, _head: Sequence[str]) -> Iterator[str]:
    def without_remarks(tree: dict[str, Any]) -> dict[str, Any]:
        return {
            key: without_remarks(value) if isinstance(value, dict) else value[0]
            for key, value in tree.items()
        }

    yield json.dumps(without_remarks(_tree(file, leaves)), indent=2)


def _lua(_file: ConfigFile, leaves: Leaves, head: Sequence[str]) -> Iterator[str]:
    yield from (f"-- {line}" for line in head)
    yield from ('include "map_builder.lua"', 'include "trajectory_builder.lua"', "", "options = {")
    inside = {key: key.startswith("options/") for key, *_ in leaves}
    for is_inside in (True, False):
        for key, value, remark in leaves:
            if inside[key] is is_inside:
                text = value[1:] if isinstance(value, str) and value.startswith("=") else as_text(value)
                name, end = (f"  {key.removeprefix('options/')}", ",") if is_inside else (key, "")
                yield f"{name} = {text}{end}" + (f"  -- {remark}" if remark else "")
        yield "}\n" if is_inside else "\nreturn options"


def _shell(_file: ConfigFile, leaves: Leaves, head: Sequence[str]) -> Iterator[str]:
    yield from (f"# {line}" for line in head)
    yield from (
        f"export {key}={value}" + (f"  # {remark}" if remark else "") for key, value, remark in leaves
    )


def _launch(file: ConfigFile, leaves: Leaves, head: Sequence[str]) -> Iterator[str]:
    package, launch = file.include.split()
    parts: dict[str, list[str]] = {"remap": [], "param": []}
    for key, value, remark in leaves:
        kind, _, name = key.partition("/")
        if remark:
            text = quoteattr(value if isinstance(value, str) else as_text(value))
            words = (
                f"from={quoteattr(name)} to={text}"
                if kind == "remap"
                else f"name={quoteattr(name)} value={text}"
            )
            parts[kind] += [f"  <!-- {remark} -->", f"  <{kind} {words} />"]
    yield from ("<launch>", *(f"  <!-- {line} -->" for line in head), *parts["remap"])
    yield f'  <include file="$(find {package})/launch/{launch}" />'
    yield from (
        *parts["param"],
        "</launch>",
    )  # after the include, because the last value of a parameter is used


_FORMATS: Mapping[str, Callable[[ConfigFile, Leaves, Sequence[str]], Iterator[str]]]
_FORMATS = {"yaml": _yaml, "json": _json_file, "lua": _lua, "sh": _shell, "launch": _launch}


def as_text(value: Any) -> str:
    """Write a value in the syntax that JSON, YAML and Lua share: YAML 1.1 does not read 1e-9 without a point."""
    if isinstance(value, list):
        return f"[{', '.join(map(as_text, value))}]"
    text = json.dumps(value)
    return text.replace("e", ".0e") if isinstance(value, float) and "e" in text and "." not in text else text

"""Configurations of SLAM programs for a rig, from `templates/`, and what each needs of a bag."""

import json
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import NamedTuple, Self

import numpy as np

from vlp16emu.elementary import inverse, matmul
from vlp16emu.errors import InputError, OutputError
from vlp16emu.extras.truth.truth import given_mount
from vlp16emu.inputs import read_text
from vlp16emu.models import MODEL_NAMES
from vlp16emu.output import OutputFile, final_name
from vlp16emu.sensor.beams import MODELS, SEQUENCE_NS
from vlp16emu.trees import Table
from vlp16emu.types import F8, AnyArray, SensorModel

_COLUMNS = 1_080_000
"""Columns per revolution of a VLP-16 times rpm: 1800 at 600 rpm, as in LIO-SAM and LeGO-LOAM
(config/params.yaml, utility.h); of other models by the period of their firing sequences."""
_REMARK = re.compile(r"(?P<value>[^\s=]+|\[.*\])  # .*; its own value is (?P<default>.*)$", re.MULTILINE)
"""Value at the end of a line of YAML or of a shell, and its remark: reason, and default of the program."""
_ELEMENT = re.compile(
    r'^ *<!-- .*; its own value is (?P<default>.*) -->\n.* (to|value)="(?P<value>.*)" />\n', re.MULTILINE
)
"""Element of a launch file, after its remark."""


class Program(NamedTuple):
    """SLAM program: a row of `programs.toml`."""

    name: str
    files: list[str]
    needs: Mapping[str, str]  # by rule of `fitness`: value to set, and consequence otherwise
    rest_s: float = 0.0  # required time at rest at the start


@cache
def programs() -> Mapping[str, Program]:
    """Return all programs by name, in the order of the table."""
    table = tomllib.loads(files(__package__).joinpath("programs.toml").read_text(encoding="utf-8"))
    return {name: Program(name, **row) for name, row in table.items()}


def programs_named(name: str, *, where: str = "--for") -> list[Program]:
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
    imu: Table | None = None  # section of the scene
    lidar_frame: str = "velodyne"
    model: SensorModel = SensorModel.VLP_16

    @classmethod
    def from_truth(cls, rig: Table, scenario: Table, frame: str) -> Self:
        """Return the rig of the first unit, with lidar frame `frame`, from `rig.json` and `scenario.json`.

        Raises InputError if the model is not known.
        """
        imu = given_mount(rig["imu"], "body_T_imu") if "imu" in rig else None
        lidar = given_mount(rig["units"][0], "body_T_sensor")
        sensor = scenario["sensor"]
        name = sensor.get("model", SensorModel.VLP_16)
        if name not in MODEL_NAMES:
            raise InputError("scenario.json: sensor.model", f"found {name}", " or ".join(MODEL_NAMES))
        return cls(float(sensor["rpm"]), lidar, imu, scenario.get("imu"), frame, SensorModel(name))

    def names(self) -> dict[str, str]:
        """Return the texts for the names in the templates; a name is missing if the rig has no such value."""
        imu = self.imu or {}
        imu_hz = imu.get("rate_hz", 200)
        attitude = ", with attitude" if imu.get("attitude") else ""
        noise = {
            "accel_noise": imu.get("accel_noise_m_s2_sqrt_hz"),
            "gyro_noise": imu.get("gyro_noise_rad_s_sqrt_hz"),
            "accel_walk": imu.get("accel_walk_m_s3_sqrt_hz"),
            "gyro_walk": imu.get("gyro_walk_rad_s2_sqrt_hz"),
        }
        base_T_lidar = np.eye(4) if self.base_T_lidar is None else self.base_T_lidar
        base_T_imu = np.eye(4) if self.base_T_imu is None else self.base_T_imu
        poses = {
            **pose_names("imu", "lidar", matmul(inverse(base_T_imu), base_T_lidar)),
            **pose_names("lidar", "imu", matmul(inverse(base_T_lidar), base_T_imu)),
            **pose_names("base", "lidar", base_T_lidar),
            **pose_names("base", "imu", base_T_imu),
        }
        model = MODELS[self.model]
        columns = _COLUMNS * SEQUENCE_NS / model.beams.sequence_ns
        return {
            "model": model.title,
            "rings": str(model.lasers),
            "rig": f"{self.rpm:g} rpm, IMU {imu_hz} Hz{attitude}",
            "points": f"/{self.lidar_frame}_points",
            "lidar_frame": self.lidar_frame,
            "imu_with_attitude": "/imu/data" if attitude else "/imu/without_attitude",
            "sweep_hz": f"{self.rpm / 60.0:.0f}",
            "sweep_s": _number(round(60.0 / self.rpm, 9)),
            "columns": f"{columns / self.rpm:.0f}",
            "imu_s": _number(round(1.0 / imu_hz, 9)),
            **{name: _number(value) for name, value in noise.items() if value},
            **{name: f"[{', '.join(map(_number, values))}]" for name, values in poses.items()},
        }


def _number(value: float) -> str:
    """Write a number in the syntax that JSON, YAML and Lua share.

    YAML 1.1 does not read 1e-9 without a point.
    """
    text = json.dumps(value)
    return text if "." in text else text.replace("e", ".0e")


def pose_names(frame: str, child: str, T: AnyArray) -> dict[str, list[float]]:
    """Return the pose `T` (4, 4) of frame `child` in `frame` by the names that templates use.

    Each name stands for an order of numbers: translation, rotation by rows, quaternion x, y, z, w before the
    translation, and behind it as in TUM.
    """
    from scipy.spatial.transform import Rotation

    # Adding zero turns -0.0 into 0.0.
    translation = (T[:3, 3].round(9) + 0.0).tolist()
    rotation = (T[:3, :3].round(9) + 0.0).ravel().tolist()
    quaternion = (Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True).round(9) + 0.0).tolist()
    return {
        f"{frame}_t_{child}": translation,
        f"{frame}_R_{child}": rotation,
        f"{frame}_pose_{child}": quaternion + translation,
        f"{frame}_tum_{child}": translation + quaternion,
    }


def configurations(program: Program, rig: Rig) -> dict[str, str]:
    """Return the files of a configuration, by name."""
    folder = files(__package__).joinpath("templates")
    names = rig.names()
    return {
        name: _fill(folder.joinpath(name).read_text(encoding="utf-8"), names, is_json=name.endswith(".json"))
        for name in program.files
    }


def _fill(template: str, names: Mapping[str, str], *, is_json: bool) -> str:
    """Fill a template; a name without a value in the rig leaves the default of the program."""
    text = Template(template).safe_substitute(names)
    if is_json:
        return json.dumps(json.loads(text), indent=2) + "\n"
    text = _REMARK.sub(_without_idle_remark, text)
    return _ELEMENT.sub(lambda element: "" if _is_default(element) else element[0], text)


def _without_idle_remark(line: re.Match[str]) -> str:
    """Return the value of a line, with its remark if it differs from the default of the program."""
    if line["value"].startswith("$"):
        return line["default"]
    return line["value"] if _is_default(line) else line[0]


def _is_default(match: re.Match[str]) -> bool:
    """Return True if a value equals the default of the program, as numbers if both are."""
    try:
        return bool(json.loads(match["value"]) == json.loads(match["default"]))
    except ValueError:
        return match["value"].strip('"') == match["default"]


def _holds(path: Path, text: str) -> bool:
    """Return True if a file holds a text."""
    try:
        return read_text(path, "a configuration", InputError) == text
    except InputError:
        return False


def configurations_beside(bag: Path, program: Program) -> dict[str, str]:
    """Return the files of a configuration beside a bag, as `written_beside` names them; text by name.

    Raises InputError if one of them cannot be read.
    """
    paths = (final_name(bag.with_name(f"{bag.stem}.{file}")) for file in program.files)
    return {
        path.name: read_text(path, f"a configuration of {program.name}", InputError)
        for path in paths
        if path.exists()
    }


@contextmanager
def written_beside(bag: Path, name: str | None, rig: Callable[[], Rig]) -> Iterator[None]:
    """Write the configuration of a program, or of all, beside a bag when the block ends: `walk.lio-sam.yaml`.

    Raises InputError if there is no such program; OutputError if one of the files exists with other values.
    """
    texts = {
        final_name(bag.with_name(f"{bag.stem}.{file}")): text
        for program in (programs_named(name) if name is not None else ())
        for file, text in configurations(program, rig()).items()
    }
    for path, text in texts.items():
        if path.exists() and not _holds(path, text):
            raise OutputError(str(path), "is there already, with other values", "another name for the bag")
    yield
    for path, text in texts.items():
        with OutputFile(path) as output, output.writing() as file:
            file.write(text.encode())

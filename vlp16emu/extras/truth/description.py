"""Descriptions of the sensors of a run, `rig.json` and `scenario.json`, as they are read from a folder."""

from pathlib import Path
from typing import Annotated, Any, NotRequired, TypeVar

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError, with_config
from typing_extensions import TypedDict

from vlp16emu.errors import InputError
from vlp16emu.explain import explain
from vlp16emu.inputs import parse_json, read_text
from vlp16emu.settings import ExpectationError
from vlp16emu.trees import Table

T = TypeVar("T")
_FARTHEST_M = 1e6  # longest translation
_SKEW = 1e-6  # greatest departure of unit axes from length, right angle and right-handedness
PARTIAL = ConfigDict(extra="allow", allow_inf_nan=False, strict=True)
"""Of tables with members that are not checked, as nothing that reads them here needs those."""


def _file_name(name: str) -> str:
    if Path(name).name != name or "\0" in name:
        raise ExpectationError("the name of a file in this folder")
    return name


def _rigid(matrix: list[list[float]]) -> list[list[float]]:
    if [len(row) for row in matrix] == [4] * 4:
        T = np.clip(np.array(matrix), -_FARTHEST_M, _FARTHEST_M)
        x, y, z = T[:3, :3]
        is_bounded = np.abs(T).max() < _FARTHEST_M and (T[3] == [0.0, 0.0, 0.0, 1.0]).all()
        lengths = np.array([(x**2).sum(), (y**2).sum(), (x * y).sum()])
        if is_bounded and np.abs([*(lengths - [1, 1, 0]), *(np.cross(x, y) - z)]).max() < _SKEW:
            return matrix
    raise ExpectationError("four rows of four numbers, a rotation and a translation")


FileName = Annotated[str, AfterValidator(_file_name)]
"""Name of a file beside the description: no path leads out of the folder."""
Matrix = Annotated[list[list[float]], AfterValidator(_rigid)]
"""Rigid transform (4, 4)."""


@with_config(PARTIAL)
class _Extrinsics(TypedDict):
    matrix: Matrix
    spin_hz: NotRequired[float]


@with_config(PARTIAL)
class _Unit(TypedDict):
    trajectory: FileName
    address: str
    data_port: int
    body_T_sensor: _Extrinsics
    given_body_T_sensor: NotRequired[_Extrinsics]


@with_config(PARTIAL)
class _InertialUnit(TypedDict):
    body_T_imu: _Extrinsics
    given_body_T_imu: NotRequired[_Extrinsics]


@with_config(PARTIAL)
class CameraOnRig(TypedDict):
    """Extrinsics of a camera."""

    body_T_camera: _Extrinsics
    given_body_T_camera: NotRequired[_Extrinsics]


@with_config(PARTIAL)
class _Antenna(TypedDict):
    above_sensor_m: float


@with_config(PARTIAL)
class _World(TypedDict):
    latitude_deg: Annotated[float, Field(ge=-90, le=90)]
    longitude_deg: Annotated[float, Field(ge=-180, le=180)]
    height_m: float


@with_config(PARTIAL)
class _Rig(TypedDict):
    world: _World
    units: Annotated[list[_Unit], Field(min_length=1)]
    antenna: _Antenna
    imu: NotRequired[_InertialUnit]
    camera: NotRequired[CameraOnRig]


_Positive = Annotated[float, Field(gt=0)]
_Error = Annotated[float, Field(ge=0, le=1e6)]


@with_config(PARTIAL)
class _SpeedOfRotor(TypedDict):
    rpm: _Positive


@with_config(PARTIAL)
class _InertialErrors(TypedDict):
    rate_hz: Annotated[int, Field(gt=0)]
    attitude: bool
    gyro_noise_rad_s_sqrt_hz: _Error
    accel_noise_m_s2_sqrt_hz: _Error
    gyro_walk_rad_s2_sqrt_hz: _Error
    accel_walk_m_s3_sqrt_hz: _Error
    accel_bias_m_s2: _Error


@with_config(PARTIAL)
class _ReceiverErrors(TypedDict):
    position_noise_m: _Error
    wander_m: _Error


@with_config(PARTIAL)
class _Scenario(TypedDict):
    sensor: _SpeedOfRotor
    gps: _ReceiverErrors
    imu: NotRequired[_InertialErrors]


_RIG = TypeAdapter[Table](_Rig)
_SCENARIO = TypeAdapter[Table](_Scenario)


def read_rig(folder: Path, expected: str) -> Table:
    """Read `rig.json`; InputError, with the member's name, if it is none."""
    return read_members(folder / "rig.json", expected, _RIG)


def read_scenario(folder: Path, expected: str) -> Table:
    """Read the speed of the rotor and the errors of devices in `scenario.json`; InputError if it has none."""
    return read_members(folder / "scenario.json", expected, _SCENARIO)


def read_json(path: Path, expected: str) -> Any:
    """Read a JSON file of a folder that a run has written; InputError if it cannot be read or is no JSON."""
    text = read_text(path, expected, InputError)
    try:
        return parse_json(text)
    except ValueError:
        raise InputError(str(path), "no JSON", expected) from None


def read_members(path: Path, expected: str, kind: TypeAdapter[T]) -> T:
    """Read a JSON file and check the members that are needed; InputError names the first wrong one."""
    tree = read_json(path, expected)
    try:
        return kind.validate_python(tree)
    except ValidationError as error:
        key, found, wanted = explain(error, kind.json_schema())
        raise InputError(f"{path}: {key}" if key else str(path), found, wanted) from None

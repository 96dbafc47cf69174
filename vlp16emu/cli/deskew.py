"""The part of `vlp16emu points` that puts captures into the world."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

from vlp16emu.cli.arguments import checked, option
from vlp16emu.cli.terminal import count, finish, size, stop_on_ctrl_c, tree_of
from vlp16emu.errors import InputError

if TYPE_CHECKING:
    from vlp16emu.extras.clouds.deskew import TrajectoryErrors

_MOST_S = 7 * 86_400
_FARTHEST = 1e6
_MOUNT, _DRIFT = "X,Y,Z,ROLL,PITCH,YAW", "EAST,NORTH,UP,YAW"


def _numbers(name: str, names: str) -> Callable[[str], tuple[float, ...]]:
    """Parser of as many numbers as there are names."""
    expected = f"the numbers {names}"
    number = checked(name, float, lambda n: abs(n) <= _FARTHEST, expected)

    def parse(text: str) -> tuple[float, ...]:
        words = text.split(",")
        if len(words) != len(names.split(",")):
            raise InputError(name, f"found {text}", expected)
        return tuple(map(number, words))

    return parse


MountedAt = Annotated[
    object | None,  # click would take two values for a tuple
    option(
        "--mount",
        "Of a capture: where the sensor sits on the body of the trajectory, in m and degrees; with the true trajectory a wrong "
        "boresight and lever arm.",
        _MOUNT,
        _numbers("--mount", _MOUNT),
    ),
]
Drift = Annotated[
    object | None,
    option(
        "--drift",
        "Of a capture: let the trajectory drift, in m per minute and degrees per minute from its first pose on.",
        _DRIFT,
        _numbers("--drift", _DRIFT),
    ),
]
TimeOffset = Annotated[
    float,
    option(
        "--time-offset",
        "Of a capture: seconds added to the time of a pulse before its pose is looked up.",
        "S",
        checked("--time-offset", float, lambda s: abs(s) <= _MOST_S, f"at most {_MOST_S} s either way"),
        shown=False,
    ),
]


class LabelsWanted(NamedTuple):
    """What points are labelled with, as it is given."""

    truth: bool
    labels: str | None
    """Name of a scheme."""
    folder: Path | None
    """Truth of the run, where it is not the trajectory's folder."""


def deskew(
    capture: Path,
    out: Path,
    trajectory: Path | None,
    errors: "TrajectoryErrors",
    wanted: LabelsWanted,
    *,
    unit: int,
    as_json: bool,
) -> None:
    """Write the points of a capture."""
    if trajectory is None:
        expected = "--trajectory DIR or FILE.tum; `vlp16emu decode` leaves points in the sensor"
        raise InputError(str(capture), "is a capture", expected)
    from vlp16emu.extras.clouds.deskew import CaptureTruth, Trajectory, write_deskewed
    from vlp16emu.extras.clouds.labels import label_scheme

    way, truth = Trajectory(trajectory, unit, errors), None
    if wanted.truth or wanted.labels:
        folder = wanted.folder or trajectory
        if not folder.is_dir():
            expected = "--truth-folder DIR beside it, the folder that `record --truth-returns` has written"
            raise InputError("--labels" if wanted.labels else "--truth", "found a trajectory alone", expected)
        scheme = label_scheme(wanted.labels, where="--labels") if wanted.labels else None
        truth = CaptureTruth(folder, unit, scheme)
    with stop_on_ctrl_c() as stop:
        cloud = write_deskewed(capture, out, way, truth, stop=stop)
    rows = {
        "capture": f"{cloud.capture}, {cloud.simulated_s:.1f} s",
        "trajectory": cloud.trajectory,
        "points": count(cloud.points),
        "without pose": f"{count(cloud.without_pose)} left out",
        "labels": "yes" if cloud.truth else "no, see --truth",
        "size": size(cloud.bytes),
    }
    finish(tree_of(cloud), cloud.file, rows, as_json=as_json)

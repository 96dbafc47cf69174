"""Options of extras, for Python and the command line. They need no library, as help must be quick."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from vlp16emu.run.options import Option, Options, Span, TruthPlace, WhichUnit

_LARGEST_PX = 8_192
_MOUNT = "X,Y,Z,ROLL,PITCH,YAW"
_DRIFT = "EAST,NORTH,UP,YAW"
_FARTHEST = 1e6  # greatest of these numbers
_AUTO = "auto"
_MOST_OFFSET_S = float(2**32)  # between any two epochs in use, and far from the ends of int64 nanoseconds


def _pixels(text: str) -> tuple[int, ...]:
    words = text.lower().split("x")
    size = tuple(int(word) for word in words if word.isascii() and word.isdecimal())
    if len(words) != 2 or len(size) != 2 or not all(64 <= n <= _LARGEST_PX for n in size):
        raise ValueError(text)
    return size


def _numbers(names: str) -> Callable[[str], tuple[float, ...]]:
    """Return the parser of numbers that are named in a list such as `X,Y,Z`."""

    def parse(text: str) -> tuple[float, ...]:
        """Return the numbers of a text; ValueError if they are too few, too many or too large."""
        numbers = tuple(float(word) for word in text.split(","))
        if len(numbers) != len(names.split(",")) or not all(abs(number) <= _FARTHEST for number in numbers):
            raise ValueError(text)
        return numbers

    return parse


def _seconds_or_auto(text: str) -> float | None:
    return None if text == _AUTO else float(text)


TimeOffset = Annotated[
    float | None,
    Option(
        "Time of the trajectory's stamps minus UTC, for stamps of another epoch or with an error on purpose: "
        "the pose of a pulse is looked up so much later. auto finds it: the clock (UTC, GPS time, TAI) with "
        "which spans overlap, else both begin together; `score` then moves it until steps agree best.",
        "S|auto",
        "--time-offset",
        ge=-_MOST_OFFSET_S,
        le=_MOST_OFFSET_S,
        parse=_seconds_or_auto,
        expected=f"auto, or a number from {-_MOST_OFFSET_S:.0f} to {_MOST_OFFSET_S:.0f}",
        shown=False,
    ),
]
"""None on the command line is `auto`."""


@dataclass(frozen=True)
class TrajectoryErrors(Options):
    """Errors that a trajectory gets on purpose, to see what they do to a map."""

    time_offset_s: TimeOffset = 0.0
    mount: Annotated[
        tuple[float, ...] | None,
        Option(
            "For a capture: extrinsics of the sensor on the body of the trajectory, in m and degrees as in "
            "[motion.mount]; with the true trajectory, errors of boresight and lever arm.",
            _MOUNT,
            parse=_numbers(_MOUNT),
            expected=f"the numbers {_MOUNT}",
        ),
    ] = None
    drift: Annotated[
        tuple[float, ...] | None,
        Option(
            "For a capture: drift of the trajectory from its first pose on, in m and degrees per minute.",
            _DRIFT,
            parse=_numbers(_DRIFT),
            expected=f"the numbers {_DRIFT}",
        ),
    ] = None


@dataclass(frozen=True)
class PointOptions(Span):
    """Points of a scene."""

    unit: WhichUnit = 1
    truth: Annotated[
        bool,
        Option("Label the surface of each point: class, part, leaf or wood, plant, species.", name="--truth"),
    ] = False
    labels: Annotated[
        str | None,
        Option(
            "Classes of data sets: for-instance, digiforests, asprs or semantickitti. Also consecutive "
            "numbers of trees, height above the ground and the viewpoint.",
            "SCHEME",
        ),
    ] = None
    truth_to: Annotated[
        TruthPlace | None,
        Option(
            "For a scene: also write the files of `record --truth` to this folder. For a capture: folder "
            "that `record --truth-returns` has written, for --truth and --labels; by default the folder "
            "of --trajectory.",
            "DIR",
            "--truth-folder",
            parse=Path,
        ),
    ] = None


@dataclass(frozen=True)
class PictureLook(Options):
    """Look of a picture."""

    colour: Annotated[
        str | None,
        Option(
            "natural, class, part, species, instance, range, reflectivity, ring or time; the last four "
            "for a capture.",
            "LAYER",
            shown="natural, for a capture reflectivity",
        ),
    ] = None
    from_deg: Annotated[
        float | None,
        Option(
            "Bearing of the eye, clockwise from north, of --view slant.", "DEG", ge=0, lt=360, shown="205"
        ),
    ] = None
    size: Annotated[
        tuple[int, int],
        Option(
            "Width and height in pixels.",
            "WxH",
            parse=_pixels,
            expected=f"WIDTHxHEIGHT, from 64 to {_LARGEST_PX}",
            shown="1280x720",
        ),
    ] = (1280, 720)
    view: Annotated[
        str,
        Option(
            "slant, all points from a slant; sweep, one revolution from vertically above with circles of "
            "range; or image, one revolution as rows of lasers over the azimuth.",
            words=("slant", "sweep", "image"),
        ),
    ] = "slant"


@dataclass(frozen=True)
class ImageOptions(Span):
    """Images of a scene."""

    every_s: Annotated[
        float | None, Option("Time between images.", "S", ge=1e-3, le=86_400, shown="1 / camera.rate_hz")
    ] = None
    depth: Annotated[
        str,
        Option(
            "Depth along the optical axis: 16-bit PNG in mm, up to 65.5 m (mm), or .npy in metres (float32).",
            words=("mm", "float32"),
        ),
    ] = "mm"
    samples: Annotated[
        int,
        Option("Rays for the colour of a pixel, along each axis: 2 or 3 for smooth edges.", "N", ge=1, le=8),
    ] = 1


@dataclass(frozen=True)
class DatasetOptions(Options):
    """Workers that make the walks of a dataset."""

    workers: Annotated[
        int | None,
        Option(
            "Processes on this machine, by default one per core; 0 uses only this process. Never changes "
            "a byte.",
            "N",
            ge=0,
            le=1024,
        ),
    ] = None
    scheduler: Annotated[
        str | None,
        Option(
            "Dask scheduler whose workers make the walks, in place of processes on this machine: "
            "tcp://HOST:PORT, or its scheduler file. Never changes a byte. Needs the extra 'cluster'.",
            "ADDRESS",
        ),
    ] = None


@dataclass(frozen=True)
class ScoreInputs(Options):
    """Files to score and their ground truth."""

    truth: Annotated[Path, Option("Folder that `record --truth` has written.", name="TRUTH_DIR")]
    trajectory: Annotated[Path | None, Option("Estimated poses, TUM; KITTI with --times.", "FILE")] = None
    times: Annotated[
        Path | None, Option("A time in seconds for each pose of KITTI, one per line.", "FILE")
    ] = None
    time_offset_s: TimeOffset = 0.0
    map: Annotated[
        Path | None, Option("Points in the world: .ply, .npz, .csv, .pcd, .las or .laz.", "FILE")
    ] = None
    points: Annotated[
        Path | None, Option("Points with labels `leaf_wood`, `instance` (or `treeID`).", "FILE")
    ] = None
    stems: Annotated[Path | None, Option("Stems found: x, y, dbh (m) or dbh_cm, number.", "FILE.csv")] = None
    inventory: Annotated[Path | None, Option("True trees, from `forest --inventory`.", "FILE.csv")] = None
    truth_points: Annotated[Path | None, Option("True points, from `points --truth`.", "FILE")] = None
    unit: WhichUnit = 1
    alignment: Annotated[
        str,
        Option(
            "Alignment of the poses to the ground truth; nothing else is moved: by the first pose "
            "(start), as odometry begins anywhere; as a whole (se3), or with rotation about the vertical "
            "only (yaw); or none.",
            None,
            "--align",
            words=("start", "none", "yaw", "se3"),
        ),
    ] = "start"
    radius_m: Annotated[
        float, Option("Greatest distance of a found stem from its true one.", "M", gt=0, le=10)
    ] = 0.5

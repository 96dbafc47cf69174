"""Pictures and films of what a sensor saw, without a browser."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.deskew import Trajectory, TrajectoryErrors
from vlp16emu.emulator import Emulator
from vlp16emu.errors import InputError, MissingExtraError, OutputError
from vlp16emu.output import OutputFile
from vlp16emu.scan import Scan, decode
from vlp16emu.viewer.canvas import Canvas, Oblique
from vlp16emu.viewer.layers import Entries, colours_of, colours_of_scale, entries_of, layers_of_scan

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["PictureLook", "PictureRun", "draw_picture", "scans_of_capture", "scans_of_scene", "way_of"]

Placed = tuple[Scan, NDArray[np.float64]]
"""A revolution, and its points (n, 3) in the world."""

_STILLS, _FILMS = (".png",), (".gif", ".mp4")
_FRAMES_PER_S = 10
_ELEVATION_DEG = 32.0
_AROUND_M, _BELOW_M, _ABOVE_M = 22.0, 4.0, 22.0
"""What is in the picture around, below and above the way of the sensor."""
_SHARE = 0.93
"""Of the points in a sweep that the box of a capture in its sensor holds."""
_SENSOR_RGB = (255, 70, 50)
_BACK, _INK = "#0e1218", "#d7dbe0"
_MOST_ENTRIES = 12
_STATIONS = 200
"""Of a way that is looked at."""


@dataclass(frozen=True, slots=True)
class PictureLook:
    """How a picture is made."""

    colour: str
    """A layer, see `layers_of_scan`."""
    from_deg: float
    """Where the eye is, clockwise from north."""
    size: tuple[int, int]
    """In pixels."""


@dataclass(frozen=True, slots=True)
class PictureRun:
    """What a picture holds."""

    file: str
    revolutions: int
    points: int
    colour: str
    bytes: int
    interrupted: bool


def scans_of_scene(emulator: Emulator, start_s: float, duration_s: float | None) -> Iterator[Placed]:
    """Yield the revolutions of a scene's first sensor, with labels."""
    for scan in emulator.scans(start_s=start_s, duration_s=duration_s, truth=True):
        world_T_sensor = emulator.world_T_sensor(scan.t_ns)
        yield scan, np.einsum("nij,nj->ni", world_T_sensor[:, :3, :3], scan.xyz_m) + world_T_sensor[:, :3, 3]


def scans_of_capture(
    path: Path, trajectory: Path | None, start_s: float, duration_s: float | None
) -> Iterator[Placed]:
    """Yield the revolutions of a capture, by a trajectory or as they are in the sensor; without poses none is taken."""
    way = None if trajectory is None else Trajectory(trajectory, 1, TrajectoryErrors())
    first_ns = None
    for scan in decode(path):
        first_ns = scan.start_ns if first_ns is None else first_ns
        since_s = (scan.start_ns - first_ns) / 1e9
        if duration_s is not None and since_s >= start_s + duration_s:
            return
        if since_s < start_s or (way and not way.has(scan.t_ns).all()):
            continue
        if way is None:
            yield scan, scan.xyz_m.astype(np.float64)
        else:
            turn, place_m = way.poses_at(scan.t_ns)
            yield scan, np.einsum("nij,nj->ni", turn, scan.xyz_m) + place_m


def way_of(trajectory: Path | None) -> NDArray[np.float64] | None:
    """Give places (k, 3) of a trajectory, all over its time."""
    if trajectory is None:
        return None
    way = Trajectory(trajectory, 1, TrajectoryErrors())
    begin_s, end_s = way.span_s
    t_ns = (1e9 * np.linspace(begin_s + 1e-3, end_s - 1e-3, _STATIONS)).astype(np.int64)
    return way.poses_at(t_ns)[1]


def draw_picture(
    scans: Iterator[Placed],
    path: Path,
    look: PictureLook,
    *,
    way_m: NDArray[np.float64] | None,
    species: Mapping[int, str],
    stop: Event,
) -> PictureRun:
    """Draw what accumulates over revolutions as a picture, or how it does as a film.

    Parameters
    ----------
    scans : one after another; memory does not grow with them
    path : .png, .gif or .mp4
    way_m : (k, 3) where the sensor goes; None to look around the origin
    species : names by number
    stop : ends the picture between two revolutions

    Raises
    ------
    InputError
        where there is no revolution, or none with such a layer
    OutputError, RunError, MissingExtraError
        where the suffix is another, the file cannot be written, or a library is missing
    """
    suffix = path.suffix.lower()
    if suffix not in (*_STILLS, *_FILMS):
        raise OutputError(str(path), f"found the ending {suffix}", ", ".join((*_STILLS, *_FILMS)))
    first = next(scans, None)
    if first is None:
        raise InputError("picture", "no whole revolution", "at least one in the span")
    if look.colour not in (known := layers_of_scan(first[0])):
        raise InputError("--colour", f"found {look.colour}", ", ".join(known))
    box_m = _box_m(first[1], way_m)
    drawing = _Drawing(Canvas(Oblique(look.from_deg, _ELEVATION_DEG, look.size, box_m)), look, species, box_m)
    images = drawing.images(chain([first], scans), stop)
    with OutputFile(path) as output, output.writing() as file:
        if suffix == ".png":
            for _ in images:
                pass
            _still(file, drawing, entries_of(first[0], look.colour, species))
        else:
            (_gif if suffix == ".gif" else _mp4)(file, (drawing.marked(scan) for scan in images), look.size)
    interrupted = stop.is_set()
    return PictureRun(
        str(path), drawing.revolutions, drawing.points, look.colour, path.stat().st_size, interrupted
    )


def _box_m(first_m: NDArray[np.float64], way_m: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """Corners (2, 3) of what a picture shows."""
    if way_m is None:
        spread = np.quantile(np.abs(first_m), _SHARE, axis=0)
        return np.stack([-spread, spread])
    around = np.array([_AROUND_M, _AROUND_M, 0.0])
    low, high = way_m.min(axis=0) - around, way_m.max(axis=0) + around
    low[2], high[2] = low[2] - _BELOW_M, high[2] + _ABOVE_M
    return np.stack([low, high])


class _Drawing:
    """A canvas that revolutions are drawn on."""

    def __init__(
        self, canvas: Canvas, look: PictureLook, species: Mapping[int, str], box_m: NDArray[np.float64]
    ) -> None:
        self.canvas, self.look, self._species, self._box_m = canvas, look, species, box_m
        self.revolutions = self.points = 0

    def images(self, scans: Iterator[Placed], stop: Event) -> Iterator[Scan]:
        """Draw revolutions, and yield each when it is drawn."""
        for scan, world_m in scans:
            rgb = colours_of(scan, self.look.colour, self._species)
            # What is aside would hide what is near the way.
            shown = ((world_m >= self._box_m[0]) & (world_m <= self._box_m[1]))[:, :2].all(axis=1)
            self.canvas.add(world_m[shown], rgb[shown])
            self.revolutions, self.points = self.revolutions + 1, self.points + int(shown.sum())
            yield scan
            if stop.is_set():
                return

    def marked(self, scan: Scan) -> NDArray[np.uint8]:
        """Give the picture with the place of the sensor in it."""
        image = self.canvas.image()
        if scan.world_T_sensor is not None:
            (column,), (row,), _ = self.canvas.view.pixels(scan.world_T_sensor[None, :3, 3])
            image[max(row - 4, 0) : max(row + 5, 0), max(column - 4, 0) : max(column + 5, 0)] = _SENSOR_RGB
        return image


def _gif(file: Any, frames: Iterator[NDArray[np.uint8]], _size: tuple[int, int]) -> None:
    """Write a film as GIF, frame by frame."""
    try:
        from PIL import Image
    except ImportError:
        raise MissingExtraError("pillow", "picture", "films in .gif") from None
    made = (Image.fromarray(frame) for frame in frames)
    next(made).save(file, "GIF", save_all=True, append_images=made, duration=1000 // _FRAMES_PER_S, loop=0)


def _mp4(file: Any, frames: Iterator[NDArray[np.uint8]], size: tuple[int, int]) -> None:
    """Write a film as MP4, frame by frame; ffmpeg writes by name."""
    try:
        from imageio_ffmpeg import write_frames
    except ImportError:
        raise MissingExtraError("imageio-ffmpeg", "picture", "films in .mp4") from None
    writer = write_frames(file.name, size, fps=_FRAMES_PER_S, macro_block_size=2, output_params=["-f", "mp4"])
    writer.send(None)
    for frame in frames:
        writer.send(np.ascontiguousarray(frame))
    writer.close()


def _still(file: Any, drawing: _Drawing, entries: Entries) -> None:
    """Write a picture with its legend, or scale of colours, and a bar of ten metres."""
    try:
        from matplotlib.figure import Figure
        from matplotlib.patches import Patch
    except ImportError:
        raise MissingExtraError("matplotlib", "picture", "pictures") from None
    (width, height), px_per_m = drawing.look.size, drawing.canvas.view.px_per_m
    figure = Figure(figsize=(width / 100, height / 100), dpi=100, facecolor=_BACK)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.imshow(drawing.canvas.image(), extent=(0, width, 0, height), interpolation="none")
    axes.set(xlim=(0, width), ylim=(0, height))
    axes.axis("off")
    axes.plot([30, 30 + 10 * px_per_m], [30, 30], color=_INK, lw=2.5, solid_capstyle="butt")
    colour = drawing.look.colour
    shown_by = "in natural colours" if colour == "natural" else f"by {colour}"
    box = {"facecolor": _BACK, "edgecolor": "none", "alpha": 0.7, "pad": 2.0}
    axes.text(30, 40, "10 m", color=_INK, fontsize=10, bbox=box)
    axes.text(
        30,
        height - 18,
        f"{drawing.points / 1e6:.2f} million points, {shown_by}",
        color=_INK,
        fontsize=10,
        va="top",
        bbox=box,
    )
    if isinstance(entries, Mapping):
        shown = [
            Patch(color=f"#{rgb[0]:02x}{rgb[1]:02x}{rgb[2]:02x}", label=name.replace("_", " "))
            for name, rgb in list(entries.items())[:_MOST_ENTRIES]
        ]
        axes.legend(
            handles=shown,
            loc="upper right",
            fontsize=9,
            facecolor=_BACK,
            edgecolor="#3a4452",
            labelcolor=_INK,
        )
    elif entries is not None:
        _scale(figure, *entries)
    figure.savefig(file, format="png", metadata={"Software": None}, pil_kwargs={"optimize": True})


def _scale(figure: "Figure", least: float, most: float, unit: str) -> None:
    """Draw a scale of colours at the right."""
    bar = figure.add_axes((0.955, 0.25, 0.012, 0.5))
    bar.imshow(
        colours_of_scale(np.linspace(least, most, 256), least, most)[:, None],
        origin="lower",
        aspect="auto",
        extent=(0, 1, least, most),
    )
    bar.set_xticks([])
    bar.tick_params(colors=_INK, labelsize=9)
    bar.set_title(unit, color=_INK, fontsize=9)

"""Pictures and films of what a sensor saw, without a browser."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.deskew import Trajectory, TrajectoryErrors
from vlp16emu.emulator import Emulator
from vlp16emu.errors import InputError, MissingExtraError, OutputError
from vlp16emu.output import OutputFile
from vlp16emu.plots import BACK, plotted, scale_bar
from vlp16emu.scan import Scan, decode
from vlp16emu.viewer.canvas import Canvas, LaserRows, Oblique, View
from vlp16emu.viewer.layers import Entries, colours_of, colours_of_scale, entries_of, layers_of_scan

if TYPE_CHECKING:
    from matplotlib.figure import Figure


Placed = tuple[Scan, NDArray[np.float64]]
"""A revolution, and its points (n, 3) in the world."""

VIEWS = ("slant", "sweep", "image")
"""Points that add up from above at a slant; a revolution from straight above; a revolution as its lasers see it."""
_STILLS, _FILMS = (".png",), (".gif", ".mp4")
_FRAMES_PER_S, _ELEVATION_DEG = 10, 32.0
_AROUND_M, _BELOW_M, _ABOVE_M = 22.0, 4.0, 22.0
"""What is in the picture around, below and above the way of the sensor."""
_SHARE = 0.93
"""Of the points in a sweep that the box of a capture in its sensor holds."""
_CIRCLES_M, _MOST_CIRCLES = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0), 6
_DEEP_M, _CIRCLE_RGB = -1e3, (58, 68, 82)
"""Circles of range about the sensor are behind all points."""
_SENSOR_RGB = (255, 70, 50)
_MOST_ENTRIES = 12
_MILLIONS = 100_000
"""Points from which on they are counted in millions."""
_STATIONS = 200
"""Of a way that is looked at."""


@dataclass(frozen=True, slots=True)
class PictureLook:
    """How a picture is made."""

    colour: str
    """A layer, see `layers_of_scan`."""
    from_deg: float
    """Where the eye is, clockwise from north; of the view "slant"."""
    size: tuple[int, int]
    """In pixels."""
    view: str = "slant"
    """One of `VIEWS`."""


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
    rings: int,
    species: Mapping[int, str],
    stop: Event,
) -> PictureRun:
    """Draw what accumulates over revolutions as a picture, or how it does as a film; other views draw them one by one.

    Parameters
    ----------
    scans : one after another; memory does not grow with them
    path : .png, .gif or .mp4
    way_m : (k, 3) where the sensor goes; None to look around the origin
    rings : lasers of the sensor
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
    drawing = _DRAWINGS[look.view](look, species, first, way_m, rings)
    one_by_one = suffix in _STILLS and not drawing.adds_up
    images = drawing.images(chain([first], islice(scans, 0) if one_by_one else scans), stop)
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


class _Drawing:
    """A canvas that revolutions are drawn on: seen at a slant, in the world, where their points add up.

    Parameters
    ----------
    first : revolution
    """

    adds_up = True

    def __init__(
        self,
        look: PictureLook,
        species: Mapping[int, str],
        first: Placed,
        way_m: NDArray[np.float64] | None,
        rings: int,
    ) -> None:
        self.look, self._species = look, species
        self.revolutions = self.points = 0
        self.canvas = Canvas(self._view(first, way_m, rings))

    def _view(self, first: Placed, way_m: NDArray[np.float64] | None, _rings: int) -> View:
        """Look at what is around the way, or around the sensor."""
        if way_m is None:
            spread = np.quantile(np.abs(first[1]), _SHARE, axis=0)
            self._box_m = np.stack([-spread, spread])
        else:
            around = np.array([_AROUND_M, _AROUND_M, 0.0])
            low, high = way_m.min(axis=0) - around, way_m.max(axis=0) + around
            low[2], high[2] = low[2] - _BELOW_M, high[2] + _ABOVE_M
            self._box_m = np.stack([low, high])
        return Oblique(self.look.from_deg, _ELEVATION_DEG, self.look.size, self._box_m)

    def images(self, scans: Iterator[Placed], stop: Event) -> Iterator[Scan]:
        """Draw revolutions, and yield each when it is drawn."""
        for scan, world_m in scans:
            if not self.adds_up:
                self.canvas.clear()
            rgb = colours_of(scan, self.look.colour, self._species)
            self.points += self._draw(scan, world_m, rgb)
            self.revolutions += 1
            yield scan
            if stop.is_set():
                return

    def _draw(self, _scan: Scan, world_m: NDArray[np.float64], rgb: NDArray[np.uint8]) -> int:
        # What is aside would hide what is near the way.
        shown = ((world_m >= self._box_m[0]) & (world_m <= self._box_m[1]))[:, :2].all(axis=1)
        self.canvas.add(world_m[shown], rgb[shown])
        return int(shown.sum())

    def _sensor(self, scan: Scan) -> NDArray[np.float64] | None:
        """Where the sensor is in the picture (3,), if it is."""
        return None if scan.world_T_sensor is None else scan.world_T_sensor[:3, 3]

    def marked(self, scan: Scan) -> NDArray[np.uint8]:
        """Give the picture with the place of the sensor in it."""
        image = self.canvas.image()
        if (sensor := self._sensor(scan)) is not None:
            (column,), (row,), _ = self.canvas.view.pixels(sensor[None])
            image[max(row - 4, 0) : max(row + 5, 0), max(column - 4, 0) : max(column + 5, 0)] = _SENSOR_RGB
        return image

    def labels(self) -> Iterator[tuple[float, float, str]]:
        """Yield what stands at columns and rows from below of a still, beside the bar of ten metres."""
        return iter(())


class _Above(_Drawing):
    """A revolution from straight above, azimuth 0 upwards, with circles of range."""

    adds_up = False

    def _view(self, first: Placed, _way_m: NDArray[np.float64] | None, _rings: int) -> View:
        """Look at what is around the sensor."""
        radius_m = float(np.quantile(first[0].distance_m, _SHARE))
        width, height = self.look.size
        corner_m = radius_m * np.array([width, height, height]) / min(width, height)
        self._box_m = np.stack([-corner_m, corner_m])
        turn = np.linspace(0.0, 2.0 * np.pi, 4 * max(width, height))
        step_m = next((m for m in _CIRCLES_M if radius_m < _MOST_CIRCLES * m), _CIRCLES_M[-1])
        self._radii_m = np.arange(step_m, np.hypot(*corner_m[:2]), step_m)
        x, y = np.outer(self._radii_m, np.sin(turn)).ravel(), np.outer(self._radii_m, np.cos(turn)).ravel()
        self._circles_m = np.column_stack([x, y, np.full(len(x), _DEEP_M)])
        return Oblique(180.0, 90.0, self.look.size, self._box_m)

    def _draw(self, scan: Scan, _world_m: NDArray[np.float64], rgb: NDArray[np.uint8]) -> int:
        """See `_Drawing`."""
        self.canvas.add(
            self._circles_m, np.broadcast_to(np.array(_CIRCLE_RGB, np.uint8), self._circles_m.shape)
        )
        # Azimuth 0 is x of the points and upwards in the picture.
        seen_m = np.column_stack([-scan.xyz_m[:, 1], scan.xyz_m[:, 0], scan.xyz_m[:, 2]]).astype(np.float64)
        return super()._draw(scan, seen_m, rgb)

    def _sensor(self, _scan: Scan) -> NDArray[np.float64] | None:
        """See `_Drawing`."""
        return np.zeros(3)

    def labels(self) -> Iterator[tuple[float, float, str]]:
        """Yield the radii of circles, halfway from ahead to the right."""
        width, height = self.look.size
        for radius_m in self._radii_m:
            (column,), (row,), _ = self.canvas.view.pixels(
                np.array([[*np.full(2, radius_m * np.sqrt(0.5)), 0.0]])
            )
            if 30 < row < height - 30 and 0 < column < width:
                yield column + 4, height - row + 4, f"{radius_m:g} m"


class _Rows(_Drawing):
    """A revolution as the sensor measures it: a row for each laser, and azimuths."""

    adds_up = False

    def _view(self, _first: Placed, _way_m: NDArray[np.float64] | None, rings: int) -> View:
        self._rows = LaserRows(self.look.size, rings)
        return self._rows

    def _draw(self, scan: Scan, _world_m: NDArray[np.float64], rgb: NDArray[np.uint8]) -> int:
        """See `_Drawing`."""
        # Of several returns the nearest is in front, but by so little that none is in another one's shadow.
        near = -1e-6 * scan.distance_m
        self.canvas.add(np.column_stack([scan.azimuth_deg % 360.0, scan.ring, near]), rgb)
        return len(rgb)

    def _sensor(self, _scan: Scan) -> NDArray[np.float64] | None:
        """See `_Drawing`."""
        return None

    def labels(self) -> Iterator[tuple[float, float, str]]:
        """Yield azimuths below, and the first and last ring at the left."""
        rows, height = self._rows, self.look.size[1]
        below = height - rows.top - rows.height - 20
        for azimuth_deg in range(0, 360, 45):
            yield rows.left + azimuth_deg * rows.width / 360.0, below, f"{azimuth_deg}\N{DEGREE SIGN}"
        for ring in (0, rows.rings - 1):
            yield 8, height - rows.top - (rows.rings - ring - 0.4) * rows.height / rows.rings, f"ring {ring}"


_DRAWINGS = dict(zip(VIEWS, (_Drawing, _Above, _Rows), strict=True))


def _gif(file: Any, frames: Iterator[NDArray[np.uint8]], _size: tuple[int, int]) -> None:
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
    width, height = drawing.look.size
    with plotted(file, (width, height), layout=None) as figure:
        axes = figure.add_axes((0, 0, 1, 1))
        axes.imshow(drawing.canvas.image(), extent=(0, width, 0, height), interpolation="none")
        axes.set(xlim=(0, width), ylim=(0, height))
        axes.axis("off")
        if isinstance(view := drawing.canvas.view, Oblique) and drawing.adds_up:
            scale_bar(axes, view.px_per_m, 10.0, (30, 30))
        colour = drawing.look.colour
        shown_by = "in natural colours" if colour == "natural" else f"by {colour}"
        text = partial(
            axes.text, fontsize=10, bbox={"facecolor": BACK, "edgecolor": "none", "alpha": 0.7, "pad": 2.0}
        )
        for column, up, words in drawing.labels():
            text(column, up, words)
        many = drawing.points
        points = f"{many / 1e6:.2f} million" if many >= _MILLIONS else f"{many:,}".replace(",", " ")
        which = "" if drawing.adds_up else " of a revolution"
        text(30, height - 18, f"{points} points{which}, {shown_by}", va="top")
        if isinstance(entries, Mapping):
            from matplotlib.patches import Patch

            shown = [
                Patch(color=f"#{rgb[0]:02x}{rgb[1]:02x}{rgb[2]:02x}", label=name.replace("_", " "))
                for name, rgb in list(entries.items())[:_MOST_ENTRIES]
            ]
            axes.legend(handles=shown, loc="upper right", fontsize=9)
        elif entries is not None:
            _scale(figure, *entries)


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
    bar.tick_params(labelsize=9)
    bar.set_title(unit, fontsize=9)

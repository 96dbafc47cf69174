"""Pictures and films of what a sensor saw, without a browser."""

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice, product
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import InputError, MissingExtraError, OutputError
from vlp16emu.extras.clouds.deskew import Trajectory, TrajectoryErrors
from vlp16emu.extras.plots import BACK, plotted, scale_bar
from vlp16emu.extras.viewer.layers import Entries, colours_of, colours_of_scale, entries_of, layers_of_scan
from vlp16emu.extras.viewer.sweeps import Sweep, by_trajectory
from vlp16emu.output import OutputFile, spare
from vlp16emu.scan import decode

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

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
_BACKGROUND = (14, 18, 24)
_RELIEF = 0.35
"""How dark a pixel gets per metre by which its neighbours are nearer: eye-dome lighting (Boucheny, thesis, Grenoble 2009)."""
_DARKEST = 0.3
_NEAR_PX = 2
"""How far off the neighbours are."""
_FEWEST_COLUMNS = 800
"""Firing sequences of a revolution at 1200 rpm are some 900."""


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


def sweeps_of_capture(path: Path, trajectory: Path | None, start_s: float, duration_s: float | None) -> Iterator[Sweep]:
    """Yield the revolutions of a capture, by a trajectory or as they are in the sensor; those beyond its poses are left out."""
    way = None if trajectory is None else Trajectory(trajectory, 1, TrajectoryErrors())
    first_ns = None
    for scan in decode(path):
        first_ns = scan.start_ns if first_ns is None else first_ns
        since_s = (scan.start_ns - first_ns) / 1e9
        if duration_s is not None and since_s >= start_s + duration_s:
            return
        if since_s >= start_s and (way is None or way.has(scan.t_ns).all()):
            yield by_trajectory(scan, way)


def way_of(trajectory: Path | None) -> Array | None:
    """Give places (k, 3) of a trajectory, all over its time."""
    if trajectory is None:
        return None
    way = Trajectory(trajectory, 1, TrajectoryErrors())
    begin_s, end_s = way.span_s
    t_ns = (1e9 * np.linspace(begin_s + 1e-3, end_s - 1e-3, _STATIONS)).astype(np.int64)
    return way.poses_at(t_ns)[1]


def draw_picture(
    sweeps: Iterator[Sweep],
    path: Path,
    look: PictureLook,
    *,
    way_m: Array | None,
    rings: int,
    species: Mapping[int, str],
    stop: Event,
    inputs: Collection[Path] = (),
) -> PictureRun:
    """Draw what accumulates over revolutions as a picture, or how it does as a film; other views draw them one by one.

    InputError where there is no revolution, or none with such a layer; OutputError where the suffix is no picture's.

    Parameters
    ----------
    sweeps : one after another; memory does not grow with them
    path : .png, .gif or .mp4
    way_m : (k, 3) where the sensor goes; None to look around the origin
    rings : lasers of the sensor
    species : names by number
    stop : ends the picture between two revolutions
    inputs : files that are read, which the picture may not replace
    """
    spare(inputs, path)
    suffix = path.suffix.lower()
    if suffix not in (*_STILLS, *_FILMS):
        raise OutputError(str(path), f"found the ending {suffix}", ", ".join((*_STILLS, *_FILMS)))
    first = next(sweeps, None)
    if first is None:
        raise InputError("picture", "no whole revolution", "at least one in the span")
    if look.colour not in (known := layers_of_scan(first.scan)):
        raise InputError("--colour", f"found {look.colour}", ", ".join(known))
    drawing = _Drawing(_view(look, first, way_m, rings), look.colour, species)
    one_by_one = suffix in _STILLS and not drawing.view.adds_up
    images = drawing.images(chain([first], islice(sweeps, 0) if one_by_one else sweeps), stop)
    with OutputFile(path) as output, output.writing() as file:
        if suffix == ".png":
            for _ in images:
                pass
            _still(file, drawing, entries_of(first.scan, look.colour, species))
        else:
            (_gif if suffix == ".gif" else _mp4)(file, (drawing.marked(sweep) for sweep in images), look.size)
    interrupted = stop.is_set()
    return PictureRun(str(path), drawing.revolutions, drawing.points, look.colour, path.stat().st_size, interrupted)


class View:
    """Where the points of a sweep are in a picture, and what stands beside them."""

    adds_up = False
    """Whether the points of all sweeps are in the picture, and not those of one."""
    size: tuple[int, int]
    """Width and height, in pixels."""
    dot_px: tuple[int, int] = (2, 2)
    """Width and height of a point."""
    circles_m: Array = np.zeros((0, 3))
    """(k, 3) points of circles of range."""
    labels: tuple[tuple[float, float, str], ...] = ()
    """What stands at columns and rows from below of a still."""

    def pixels(self, place: Array) -> tuple[Whole, Whole, Array]:
        """Column, row and distance towards the eye of places (n, 3)."""
        raise NotImplementedError

    def places(self, sweep: Sweep) -> Array:
        """Places (n, 3) of the points of a sweep."""
        raise NotImplementedError

    def shows(self, place: Array) -> NDArray[np.bool_]:
        """Which places (n, 3) are shown."""
        return np.ones(len(place), np.bool_)

    def sensor(self, _sweep: Sweep) -> Array | None:
        """Place (3,) of the sensor, if it is in the picture."""
        return None


class Oblique(View):
    """A view of the world from above at a slant, without perspective: lengths across it are the same everywhere.

    Parameters
    ----------
    from_deg : where the eye is, clockwise from north
    elevation_deg : how high it is above the horizon
    box_m : (2, 3) corners of what has to be in the picture
    """

    adds_up = True

    def __init__(self, from_deg: float, elevation_deg: float, size: tuple[int, int], box_m: Array) -> None:
        a, e = math.radians(from_deg), math.radians(elevation_deg)
        right = np.array([-math.cos(a), math.sin(a), 0.0])
        back = np.array([math.sin(a) * math.cos(e), math.cos(a) * math.cos(e), math.sin(e)])
        self._axes = np.stack([right, np.cross(back, right), back])
        seen_m = np.array(list(product(*box_m.T))) @ self._axes.T
        low_m, high_m = seen_m.min(axis=0), seen_m.max(axis=0)
        self.size, self._box_m = size, box_m
        self.px_per_m = float(min(size[0] / (high_m[0] - low_m[0]), size[1] / (high_m[1] - low_m[1])))
        self._middle_m = (low_m + high_m) / 2

    def pixels(self, place: Array) -> tuple[Whole, Whole, Array]:
        """See `View`; distances are in m."""
        right, up, near = ((place @ self._axes.T) - self._middle_m).T
        column = np.floor(self.size[0] / 2 + right * self.px_per_m).astype(np.int64)
        return column, np.floor(self.size[1] / 2 - up * self.px_per_m).astype(np.int64), near

    def places(self, sweep: Sweep) -> Array:
        """See `View`; in the world."""
        return sweep.world_m

    def shows(self, place: Array) -> NDArray[np.bool_]:
        """See `View`: what is aside would hide what is near the way."""
        near: NDArray[np.bool_] = ((place >= self._box_m[0]) & (place <= self._box_m[1]))[:, :2].all(axis=1)
        return near

    def sensor(self, sweep: Sweep) -> Array | None:
        """See `View`."""
        world_T_sensor = sweep.scan.world_T_sensor
        return None if world_T_sensor is None else world_T_sensor[:3, 3]


class Above(Oblique):
    """A sweep from straight above to a radius, azimuth 0 upwards, with circles of range."""

    adds_up = False

    def __init__(self, size: tuple[int, int], radius_m: float) -> None:
        width, height = size
        corner_m = radius_m * np.array([width, height, height]) / min(width, height)
        super().__init__(180.0, 90.0, size, np.stack([-corner_m, corner_m]))
        turn = np.linspace(0.0, 2.0 * np.pi, 4 * max(width, height))
        step_m = next((m for m in _CIRCLES_M if radius_m < _MOST_CIRCLES * m), _CIRCLES_M[-1])
        radii_m = np.arange(step_m, np.hypot(*corner_m[:2]), step_m)
        x, y = np.outer(radii_m, np.sin(turn)).ravel(), np.outer(radii_m, np.cos(turn)).ravel()
        self.circles_m = np.column_stack([x, y, np.full(len(x), _DEEP_M)])
        # Halfway from ahead to the right.
        column, row, _ = self.pixels(np.outer(radii_m, [math.sqrt(0.5), math.sqrt(0.5), 0.0]))
        self.labels = tuple(
            (x + 4, height - y + 4, f"{radius_m:g} m")
            for x, y, radius_m in zip(column.tolist(), row.tolist(), radii_m, strict=True)
            if 30 < y < height - 30 and 0 < x < width
        )

    def places(self, sweep: Sweep) -> Array:
        """See `View`: azimuth 0 is x of the points and upwards in the picture."""
        x, y, z = sweep.scan.xyz_m.T
        return np.column_stack([-y, x, z]).astype(np.float64)

    def sensor(self, _sweep: Sweep) -> Array | None:
        """See `View`."""
        return np.zeros(3)


class LaserRows(View):
    """A sweep as the sensor measures it: a row for each laser, the highest one above, and azimuths from left to right."""

    def __init__(self, size: tuple[int, int], rings: int) -> None:
        self.size, self.rings = size, rings
        width, height = size
        self.left, self.top = round(0.06 * width), round(0.1 * height)
        """Of the pixel that is azimuth 0 of the highest laser."""
        self.width, self.height = round(0.85 * width), height - 2 * self.top
        self.dot_px = 1 + self.width // _FEWEST_COLUMNS, -(-self.height // rings)
        below, per_ring = height - self.top - self.height - 20, self.height / rings
        self.labels = (
            *((self.left + deg * self.width / 360.0, below, f"{deg}\N{DEGREE SIGN}") for deg in range(0, 360, 45)),
            *((8, height - self.top - (rings - n - 0.4) * per_ring, f"ring {n}") for n in (0, rings - 1)),
        )

    def pixels(self, place: Array) -> tuple[Whole, Whole, Array]:
        """See `View`; places are azimuth (deg), ring and nearness."""
        azimuth_deg, ring, near = place.T
        column = self.left + np.floor(azimuth_deg * self.width / 360.0).astype(np.int64)
        return column, self.top + (self.rings - 1 - ring.astype(np.int64)) * self.height // self.rings, near

    def places(self, sweep: Sweep) -> Array:
        """See `View`: of several returns the nearest is in front, by so little that none is in another one's shadow."""
        scan = sweep.scan
        return np.column_stack([scan.azimuth_deg % 360.0, scan.ring, -1e-6 * scan.distance_m])


def _view(look: PictureLook, first: Sweep, way_m: Array | None, rings: int) -> View:
    """Look at what is around the way, or without one around the sensor."""
    if look.view == "image":
        return LaserRows(look.size, rings)
    if look.view == "sweep":
        return Above(look.size, float(np.quantile(first.scan.distance_m, _SHARE)))
    if way_m is None:
        spread = np.quantile(np.abs(first.world_m), _SHARE, axis=0)
        low, high = -spread, spread
    else:
        low, high = way_m.min(axis=0), way_m.max(axis=0)
        low -= [_AROUND_M, _AROUND_M, _BELOW_M]
        high += [_AROUND_M, _AROUND_M, _ABOVE_M]
    return Oblique(look.from_deg, _ELEVATION_DEG, look.size, np.stack([low, high]))


class Canvas:
    """A picture of a view that points are added to."""

    def __init__(self, view: View) -> None:
        self.view = view
        self.clear()

    def clear(self) -> None:
        """Take away all points."""
        width, height = self.view.size
        self._near_m = np.full(height * width, -np.inf)
        self._rgb = np.zeros((height * width, 3), np.uint8)

    def add(self, world_m: NDArray[np.float64], rgb: NDArray[np.uint8]) -> None:
        """Draw points (n, 3) in colours (n, 3)."""
        width, height = self.view.size
        column, row, near_m = self.view.pixels(world_m)
        order = np.argsort(near_m, kind="stable")
        column, row, near_m, rgb = column[order], row[order], near_m[order], rgb[order]
        for x in range(self.view.dot_px[0]):
            for y in range(self.view.dot_px[1]):
                inside = (column + x >= 0) & (column + x < width) & (row + y >= 0) & (row + y < height)
                pixel = (row[inside] + y) * width + column[inside] + x
                in_front = near_m[inside] > self._near_m[pixel]
                # Points come by nearness, and of several at one pixel the last is kept.
                self._near_m[pixel[in_front]] = near_m[inside][in_front]
                self._rgb[pixel[in_front]] = rgb[inside][in_front]

    def image(self) -> NDArray[np.uint8]:
        """Give the picture (height, width, 3), with relief."""
        width, height = self.view.size
        near_m = self._near_m.reshape(height, width)
        drawn = np.isfinite(near_m)
        behind_m = np.zeros((height, width))
        flat_m = np.where(drawn, near_m, -1e6)
        for axis in (0, 1):
            for step in (-_NEAR_PX, _NEAR_PX):
                behind_m += np.clip(np.roll(flat_m, step, axis) - flat_m, 0.0, 2.0)
        light = np.maximum(np.exp(-_RELIEF * behind_m), _DARKEST)
        rgb = np.where(drawn[..., None], self._rgb.reshape(height, width, 3) * light[..., None], _BACKGROUND)
        return np.rint(rgb).astype(np.uint8)


class _Drawing(Canvas):
    """A canvas that sweeps are drawn on, in the colours of a layer."""

    def __init__(self, view: View, colour: str, species: Mapping[int, str]) -> None:
        super().__init__(view)
        self.colour, self._species, self.revolutions, self.points = colour, species, 0, 0

    def images(self, sweeps: Iterator[Sweep], stop: Event) -> Iterator[Sweep]:
        """Draw sweeps, and yield each when it is drawn."""
        view = self.view
        for sweep in sweeps:
            if not view.adds_up:
                self.clear()
                self.add(view.circles_m, np.full(view.circles_m.shape, _CIRCLE_RGB, np.uint8))
            place = view.places(sweep)
            shown = view.shows(place)
            self.add(place[shown], colours_of(sweep.scan, self.colour, self._species)[shown])
            self.points += int(shown.sum())
            self.revolutions += 1
            yield sweep
            if stop.is_set():
                return

    def marked(self, sweep: Sweep) -> NDArray[np.uint8]:
        """Give the picture with the place of the sensor in it."""
        image = self.image()
        if (sensor := self.view.sensor(sweep)) is not None:
            (column,), (row,), _ = self.view.pixels(sensor[None])
            image[max(row - 4, 0) : max(row + 5, 0), max(column - 4, 0) : max(column + 5, 0)] = _SENSOR_RGB
        return image


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
    view, colour = drawing.view, drawing.colour
    width, height = view.size
    with plotted(file, (width, height), layout=None) as figure:
        axes = figure.add_axes((0, 0, 1, 1))
        axes.imshow(drawing.image(), extent=(0, width, 0, height), interpolation="none")
        axes.set(xlim=(0, width), ylim=(0, height))
        axes.axis("off")
        if isinstance(view, Oblique) and view.adds_up:
            scale_bar(axes, view.px_per_m, 10.0, (30, 30))
        shown_by = "in natural colours" if colour == "natural" else f"by {colour}"
        text = partial(axes.text, fontsize=10, bbox={"facecolor": BACK, "edgecolor": "none", "alpha": 0.7, "pad": 2.0})
        for column, up, words in view.labels:
            text(column, up, words)
        many = drawing.points
        points = f"{many / 1e6:.2f} million" if many >= _MILLIONS else f"{many:,}".replace(",", " ")
        which = "" if view.adds_up else " of a revolution"
        text(30, height - 18, f"{points} points{which}, {shown_by}", va="top")
        if isinstance(entries, Mapping):
            from matplotlib.patches import Patch

            named = islice(entries.items(), _MOST_ENTRIES)
            shown = [Patch(color=f"#{bytes(rgb).hex()}", label=name.replace("_", " ")) for name, rgb in named]
            axes.legend(handles=shown, loc="upper right", fontsize=9)
        elif entries is not None:
            least, most, unit = entries
            colours = colours_of_scale(np.linspace(least, most, 256), least, most)[:, None]
            bar = figure.add_axes((0.955, 0.25, 0.012, 0.5))
            bar.imshow(colours, origin="lower", aspect="auto", extent=(0, 1, least, most))
            bar.set_xticks([])
            bar.tick_params(labelsize=9)
            bar.set_title(unit, fontsize=9)

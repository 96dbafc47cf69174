"""Pictures and films of what a sensor sees, without a browser."""

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from datetime import UTC, datetime
from itertools import chain, islice, product
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from vlp16emu.errors import InputError, OutputError
from vlp16emu.extras.clouds.deskew import Trajectory
from vlp16emu.extras.clouds.scan import decode
from vlp16emu.extras.options import PictureLook
from vlp16emu.extras.viewer.layers import Entries, colours_of, colours_of_scale, layers_of_scan
from vlp16emu.extras.viewer.sweeps import Sweep, place_scan, species_of, sweeps_of_scene
from vlp16emu.libraries import check_extra
from vlp16emu.output import OutputFile, spare
from vlp16emu.run.emulator import Emulator
from vlp16emu.run.options import Span
from vlp16emu.trees import Tree
from vlp16emu.types import F8, I8, U1
from vlp16emu.units import S_NS, count_text

if TYPE_CHECKING:
    from PIL.Image import Image

_BACKGROUND = (14, 18, 24)
_INK = (215, 219, 224)
_FRAME = (58, 68, 82)
_RELIEF = 0.35
"""Darkening of a pixel per metre by which its neighbours are nearer: eye-dome lighting (Boucheny, thesis,
Grenoble 2009)."""
_DARKEST = 0.3  # few shades make small files: noise is costly
_SHADES = 6
_NEIGHBOUR_PX = 2
_DOT_PX = 2

_ELEVATION_DEG = 32.0
_AROUND_M = 22.0  # extent of the picture around, below and above the path of the sensor
_BELOW_M = 4.0
_ABOVE_M = 22.0
_BOX_SHARE = 0.93  # share of a sweep's points inside the box, for a capture without trajectory
_CIRCLES_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
_MOST_CIRCLES = 6
_DEEP_M = -1e3  # circles of range about the sensor are behind all points
_MOST_ENTRIES = 16
_PALETTE = 256
_FRAME_MS = 100  # a revolution at 600 rpm
_LEGENDS = {"natural": "leaf and stem by species", "instance": "each plant and thing in a colour"}
_MILLIONS = 100_000  # number of points from which captions use millions
_FROM_DEG = 205.0  # default bearing of the eye: light falls from the south
_STATIONS = 200  # number of places along a path
_LEAST_EM_PX = 11  # least height of letters
_LINES = 38  # number of lines of text in the height of a picture, unless letters would be smaller


class Canvas:
    """Image of the points within a box, which fills it, in a parallel projection with one scale.

    Points outside the box are left out: they would hide points near the path.

    Parameters
    ----------
    box_m : corners (2, 3) of the box
    from_deg : bearing of the eye, clockwise from north
    elevation_deg : elevation of the eye, from which parallel rays come
    size : width and height in pixels
    """

    def __init__(self, box_m: F8, from_deg: float, elevation_deg: float, size: tuple[int, int]) -> None:
        self._box_m = box_m
        (width, height) = size
        self.size = size
        sin_bearing = math.sin(math.radians(from_deg))
        cos_bearing = math.cos(math.radians(from_deg))
        sin_elevation = math.sin(math.radians(elevation_deg))
        cos_elevation = math.cos(math.radians(elevation_deg))
        right = np.array([-cos_bearing, sin_bearing, 0.0])
        backward = np.array([sin_bearing * cos_elevation, cos_bearing * cos_elevation, sin_elevation])
        self._axes = np.stack([right, np.cross(backward, right), backward])  # right, up, and towards the eye
        corners_m = np.array(list(product(*box_m.T))) @ self._axes.T
        low_m, high_m = corners_m.min(axis=0), corners_m.max(axis=0)
        self._centre_m = (low_m + high_m) / 2
        self.px_per_m = float(min(width / (high_m[0] - low_m[0]), height / (high_m[1] - low_m[1])))
        self._near = np.full(height * width, -np.inf)
        self._rgb = np.zeros((height * width, 3), np.uint8)

    def pixels(self, places_m: F8) -> tuple[I8, I8, F8]:
        """Return columns, rows and nearness in metres (n,) of places (n, 3).

        At one pixel the nearest hides the others.
        """
        right, up, near = ((places_m @ self._axes.T) - self._centre_m).T
        column = np.floor(self.size[0] / 2 + right * self.px_per_m).astype(np.int64)
        return column, np.floor(self.size[1] / 2 - up * self.px_per_m).astype(np.int64), near

    def add(self, places_m: F8, rgb: U1) -> int:
        """Draw places (n, 3) in colours (n, 3), and return the number of those with x and y in the box."""
        width, height = self.size
        is_in_box = ((places_m >= self._box_m[0]) & (places_m <= self._box_m[1]))[:, :2].all(axis=1)
        column, row, near = self.pixels(places_m[is_in_box])
        order = np.argsort(near, kind="stable")
        column = column[order]
        row = row[order]
        near = near[order]
        rgb = rgb[is_in_box][order]
        for dx in range(_DOT_PX):
            for dy in range(_DOT_PX):
                x = column + dx
                y = row + dy
                inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
                pixel = y[inside] * width + x[inside]
                in_front = near[inside] > self._near[pixel]
                # Points are sorted by nearness, and numpy keeps the last of several at one pixel.
                self._near[pixel[in_front]] = near[inside][in_front]
                self._rgb[pixel[in_front]] = rgb[inside][in_front]
        return len(rgb)

    def image(self) -> U1:
        """Return the picture (height, width, 3), with relief."""
        width, height = self.size
        near = self._near.reshape(height, width)
        is_drawn = np.isfinite(near)
        behind = np.zeros((height, width))
        flat = np.where(is_drawn, near, -1e6)
        for axis in (0, 1):
            for step in (-_NEIGHBOUR_PX, _NEIGHBOUR_PX):
                behind += np.clip(np.roll(flat, step, axis) - flat, 0.0, 2.0)
        light = np.maximum(np.rint(_SHADES * np.exp(-_RELIEF * behind)) / _SHADES, _DARKEST)
        rgb = np.where(
            is_drawn[..., None], self._rgb.reshape(height, width, 3) * light[..., None], _BACKGROUND
        )
        return np.rint(rgb).astype(np.uint8)


class LaserRows:
    """Image of a revolution as its lasers see it: a band over the azimuth for each ring, the highest on top.

    Parameters
    ----------
    rings : number of lasers
    size : width and height in pixels
    """

    def __init__(self, rings: int, size: tuple[int, int]) -> None:
        self._rings = rings
        self.size = size
        self._rgb = np.full((rings, size[0], 3), _BACKGROUND, np.uint8)

    def add(self, azimuth_deg: F8, ring: I8, rgb: U1) -> int:
        """Draw points (n,) in colours (n, 3), and return their number."""
        column = (azimuth_deg / 360.0 * self.size[0]).astype(np.int64) % self.size[0]
        self._rgb[self._rings - 1 - ring, column] = rgb
        return len(rgb)

    def image(self) -> U1:
        """Return the picture (height, width, 3)."""
        return np.asarray(self._rgb[np.arange(self.size[1]) * self._rings // self.size[1]])

    def labels(self) -> list[tuple[int, int, str]]:
        """Return labels of azimuths with columns and rows."""
        width, height = self.size
        return [(width * deg // 360, height - 8, f"{deg} deg") for deg in (45, 135, 225, 315)]


def is_film(path: Path) -> bool:
    """Return True if a file is a film, by its suffix."""
    return path.suffix.lower() == ".gif"


def check_suffix(path: Path) -> None:
    """Raise OutputError if a file is not .png or .gif by its suffix, and MissingExtraError without pillow."""
    if path.suffix.lower() != ".png" and not is_film(path):
        raise OutputError(str(path), f"found the ending {path.suffix.lower()!r}", ".png, or .gif for a film")
    check_extra("picture", "a picture")


class Source(NamedTuple):
    """Sweeps of a picture, with the path, the species and the title."""

    sweeps: Iterator[Sweep]  # one after another; memory does not grow with them
    path_m: F8 | None  # (k, 3) path of the sensor; None to look around the origin
    species: Mapping[int, str]  # names by number
    inputs: Collection[Path]  # files that are read, which the picture may not replace
    title: str
    span_s: tuple[float, float] | None  # seconds of the scene; None for a capture


def source_of_capture(
    capture: Path, trajectory_file: Path | None, span: Span, *, in_sensor: bool = False
) -> Source:
    """Return the revolutions of a capture's first sensor that a trajectory covers.

    Without a trajectory, points are in the sensor's frame, and the first revolution is the only one, unless
    `in_sensor` says that this frame is wanted.
    """
    if trajectory_file is None:
        sweeps = _sweeps_of_capture(capture, None, span)
        if not in_sensor:
            sweeps = islice(sweeps, 1)
        return Source(sweeps, None, {}, [capture], capture.name, None)
    trajectory = Trajectory(trajectory_file, 1)
    begin_s, end_s = trajectory.span_s
    t_ns = (1e9 * np.linspace(begin_s + 1e-3, end_s - 1e-3, _STATIONS)).astype(np.int64)
    _, path_m = trajectory.poses_at(t_ns)
    sweeps = _sweeps_of_capture(capture, trajectory, span)
    return Source(sweeps, path_m, {}, [capture, trajectory_file], capture.name, None)


def _sweeps_of_capture(capture: Path, trajectory: Trajectory | None, span: Span) -> Iterator[Sweep]:
    """Yield the revolutions in a span since the first one; with a trajectory those that it covers fully."""
    first_ns = None
    stop_s = math.inf if span.duration_s is None else span.start_s + span.duration_s
    for scan in decode(capture, (trajectory and trajectory.sensor) or 1):
        first_ns = scan.start_ns if first_ns is None else first_ns
        since_s = (scan.start_ns - first_ns) / 1e9
        if since_s >= stop_s:
            return
        if since_s >= span.start_s and (trajectory is None or trajectory.has(scan.t_ns).all()):
            yield place_scan(scan, trajectory)


def source_of_scene(emulator: Emulator, span: Span, name: str) -> Source:
    """Return the revolutions of the first sensor of a scene named `name`, with labels."""
    scenario = emulator.scenario
    parts = emulator.parts
    ends_s = scenario.span_s(span.start_s, span.duration_s, where="--start")
    t_ns = scenario.start_ns + (np.linspace(*ends_s, _STATIONS) * 1e9).astype(np.int64)
    sweeps = sweeps_of_scene(emulator, span.start_s, span.duration_s)
    path_m = parts.motion.poses_at(t_ns).world_p_body_m
    return Source(sweeps, path_m, species_of(scenario), emulator.files, f"{name}: {scenario.title}", ends_s)


class _Drawing:
    """A picture to which revolutions are added; a view of one revolution shows the last one.

    Raises InputError if the points of the first revolution have no such layer.
    """

    def __init__(self, source: Source, look: PictureLook, first: Sweep) -> None:
        layers = layers_of_scan(first.scan)
        self.colour = look.colour or ("natural" if "natural" in layers else "reflectivity")
        if self.colour not in layers:
            raise InputError("--colour", f"found {self.colour}", ", ".join(layers))
        self._source = source
        self._look = look
        self._first = first
        self._last = first
        self._canvas = self._empty()
        self._entries: Entries = None
        self.shows_one = look.view != "slant"
        self.revolutions = 0
        self.points = 0  # in the picture, as it is now

    def _empty(self) -> Canvas | LaserRows:
        if self._look.view == "slant":
            return _slant(self._look, self._first, self._source.path_m)
        if self._look.view == "sweep":
            return _above(self._look.size, self._first)
        return LaserRows(int(self._first.scan.ring.max(initial=0)) + 1, self._look.size)

    def add(self, sweep: Sweep) -> None:
        """Add a revolution."""
        if self.shows_one:
            self._canvas = self._empty()
            self.points = 0
        scan = sweep.scan
        rgb, entries = colours_of(scan, self.colour, self._source.species)
        if isinstance(self._canvas, LaserRows):
            azimuth_deg = scan.azimuth_deg.astype(np.float64)
            self.points += self._canvas.add(azimuth_deg, scan.ring.astype(np.int64), rgb)
        else:
            self.points += self._canvas.add(_in_sensor(sweep) if self.shows_one else sweep.world_m, rgb)
        self.revolutions += 1
        self._last = sweep
        if isinstance(self._entries, Mapping) and isinstance(entries, Mapping):
            entries = {**self._entries, **entries}
        self._entries = entries

    def image(self, *, so_far: bool = False) -> "Image":
        """Return the picture with its captions; `so_far` for the time until now, not of the whole span."""
        number = count_text(self.points)
        if self.points >= _MILLIONS:
            number = f"{self.points / 1e6:.2f} million"
        suffix = " of a revolution" if self.shows_one else ""
        legend = _LEGENDS.get(self.colour, f"by {self.colour}")
        captions = self._source.title, f"{self._time(so_far=so_far)}; {number} points{suffix}, {legend}"
        labels: list[tuple[int, int, str]] = []
        bar_px = None
        if isinstance(self._canvas, LaserRows):
            labels = self._canvas.labels()
        elif self.shows_one:
            labels = _circles(self._canvas)
        else:
            bar_px = 10 * self._canvas.px_per_m
        return _annotate(self._canvas.image(), captions, self._entries, labels, bar_px)

    def _time(self, *, so_far: bool) -> str:
        span_s = self._source.span_s
        if span_s is None:
            sweep = self._last if so_far else self._first
            return f"{datetime.fromtimestamp(sweep.scan.start_ns / S_NS, UTC):%Y-%m-%d %H:%M:%S} UTC"
        now_s = span_s[0] + (self._last.scan.start_ns - self._first.scan.start_ns) / S_NS
        if self.shows_one:
            return f"from {now_s:.1f} s" if so_far else f"from {span_s[0]:g} s"
        return f"{span_s[0]:g} to {now_s:.1f} s" if so_far else f"{span_s[0]:g} to {span_s[1]:g} s"


def draw_picture(source: Source, path: Path, look: PictureLook, stop: Event) -> Tree:
    """Draw the points of a run, and return the report.

    A PNG has all revolutions or the first one, a film each revolution as a frame.

    Parameters
    ----------
    path : a path that passes `check_suffix`
    stop : ends the picture between two revolutions; before the first one with a `KeyboardInterrupt`

    Raises InputError if there is no revolution, or none with such a layer; OutputError if the file cannot be
    written.
    """
    spare(source.inputs, path)
    first = next(source.sweeps, None)
    if first is None:
        if stop.is_set():
            raise KeyboardInterrupt
        raise InputError("picture", "no whole revolution", "at least one in the span")
    drawing = _Drawing(source, look, first)
    sweeps = chain([first], () if drawing.shows_one and not is_film(path) else source.sweeps)

    def frames() -> Iterator["Image"]:
        """Add revolutions, and yield the picture after each."""
        for sweep in sweeps:
            drawing.add(sweep)
            yield _palette(drawing.image(so_far=True))
            if stop.is_set():
                return

    with OutputFile(path) as output, output.writing() as file:
        if is_film(path):
            film = frames()
            next(film).save(file, "GIF", save_all=True, append_images=film, duration=_FRAME_MS, loop=0)
        else:
            for sweep in sweeps:
                drawing.add(sweep)
                if stop.is_set():
                    break
            _small(drawing.image()).save(file, "PNG", optimize=True)
    return {
        "file": str(path),
        "revolutions": drawing.revolutions,
        "points": drawing.points,
        "colour": drawing.colour,
        "bytes": path.stat().st_size,
        "interrupted": stop.is_set(),
    }


def _slant(look: PictureLook, first: Sweep, path_m: F8 | None) -> Canvas:
    """Return a canvas at a slant for the surroundings of a path, or most points of the first sweep."""
    if path_m is None:
        spread = np.quantile(np.abs(first.world_m), _BOX_SHARE, axis=0)
        low, high = -spread, spread
    else:
        low = path_m.min(axis=0) - np.array([_AROUND_M, _AROUND_M, _BELOW_M])
        high = path_m.max(axis=0) + np.array([_AROUND_M, _AROUND_M, _ABOVE_M])
    box_m = np.stack([low, high])
    from_deg = _FROM_DEG if look.from_deg is None else look.from_deg
    return Canvas(box_m, from_deg, _ELEVATION_DEG, look.size)


def _above(size: tuple[int, int], sweep: Sweep) -> Canvas:
    """Return a canvas for a sweep seen vertically from above, up to the range of most of its points."""
    width, height = size
    corner_m = (
        np.quantile(sweep.scan.distance_m, _BOX_SHARE)
        * np.array([width, height, height])
        / min(width, height)
    )
    return Canvas(np.stack([-corner_m, corner_m]), 180.0, 90.0, size)


def _in_sensor(sweep: Sweep) -> F8:
    """Return points (n, 3) in the sensor's frame with azimuth 0 upwards in the picture."""
    ahead, left, up = sweep.scan.xyz_m.T
    return np.column_stack([-left, ahead, up]).astype(np.float64)


def _circles(canvas: Canvas) -> list[tuple[int, int, str]]:
    """Draw circles of range about the sensor, and return their labels with columns and rows."""
    width, height = canvas.size
    corner_m = np.array([width, height]) / canvas.px_per_m / 2
    steps_m = (step_m for step_m in _CIRCLES_M if corner_m.min() < _MOST_CIRCLES * step_m)
    step_m = next(steps_m, _CIRCLES_M[-1])
    radii_m = np.arange(step_m, np.hypot(*corner_m), step_m)
    turn = np.linspace(0.0, 2.0 * np.pi, 4 * max(width, height))
    x_m = np.outer(radii_m, np.sin(turn)).ravel()
    y_m = np.outer(radii_m, np.cos(turn)).ravel()
    places_m = np.column_stack([x_m, y_m, np.full(len(x_m), _DEEP_M)])
    canvas.add(places_m, np.full((len(x_m), 3), _FRAME, np.uint8))
    ahead_right = np.array([math.sqrt(0.5), math.sqrt(0.5), 0.0])
    column, row, _ = canvas.pixels(np.outer(radii_m, ahead_right))
    labels = zip(column.tolist(), row.tolist(), radii_m.tolist(), strict=True)
    return [(x, y, f"{radius_m:g} m") for x, y, radius_m in labels if 30 < y < height - 30 and 0 < x < width]


def _annotate(
    pixels: U1,
    captions: tuple[str, str],
    entries: Entries,
    labels: list[tuple[int, int, str]],
    bar_px: float | None,
) -> "Image":
    """Return a picture with its captions, labels, legend or scale of colours, and a bar of 10 m.

    `bar_px` is the length of the bar; None for no bar.
    """
    from PIL import Image, ImageDraw, ImageFont

    image = Image.fromarray(pixels)
    height, width = pixels.shape[:2]
    draw = ImageDraw.Draw(image, "RGBA")  # its colours cover by their alpha
    em = max(_LEAST_EM_PX, height // _LINES)
    font = ImageFont.load_default(em)

    def write(x: float, y: float, words: str, anchor: str) -> None:
        """Write words, readable on points; `anchor` is pillow's."""
        left, top, right, bottom = draw.textbbox((x, y), words, font, anchor)
        draw.rectangle((left - 3, top - 3, right + 3, bottom + 3), (*_BACKGROUND, 178))
        draw.text((x, y), words, _INK, font, anchor)

    edge = 2 * em
    room: float = width - 2 * edge
    for column, row, words in labels:
        write(column + 4, row - 4, words, "ls")
    if bar_px is not None:
        draw.rectangle((edge, height - edge - 2, edge + bar_px, height - edge), _INK)
        write(edge, height - edge - 2 - em // 2, "10 m", "ls")
    if isinstance(entries, Mapping) and entries:
        rows = list(islice(entries.items(), _MOST_ENTRIES))
        left = width - edge - 2.5 * em - max(draw.textlength(name, font) for name, _ in rows)
        box = left - em, em, width - em, 1.5 * em * (len(rows) + 1)
        draw.rounded_rectangle(box, em // 3, _BACKGROUND, _FRAME)
        for number, (name, colours) in enumerate(rows):
            y = 1.5 * em * number + 2 * em
            wide = 2 * em / len(colours)
            for part, rgb in enumerate(colours):
                draw.rectangle(
                    (left + part * wide, y - em // 3, left + (part + 1) * wide - 1, y + em // 3), rgb
                )
            draw.text((left + 2.5 * em, y), name, _INK, font, "lm")
        room = left - 2 * edge
    elif isinstance(entries, tuple):
        _draw_scale(image, entries, em, write)
    for line, words in enumerate(captions):
        if text := _cut_to_fit(words, room, lambda text: draw.textlength(text, font)):
            write(edge, edge + 1.6 * em * line, text, "ls")
    return image


def _cut_to_fit(words: str, room: float, length: Callable[[str], float]) -> str:
    """Return words with dots in place of their end if they are too long; empty without room for the dots."""
    if length(words) <= room:
        return words
    cuts = (f"{words[:count]}..." for count in range(len(words) - 1, -1, -1))
    return next((cut for cut in cuts if length(cut) <= room), "")


def _small(image: "Image") -> "Image":
    """Return a picture with a palette, a third of the size, if it has few colours; letters may lose some."""
    return image if image.getcolors(2 * _PALETTE) is None else _palette(image)


def _palette(image: "Image") -> "Image":
    """Return a picture with a palette, without dither, which would cost size."""
    from PIL import Image

    return image.quantize(_PALETTE, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)


def _draw_scale(
    image: "Image", scale: tuple[float, float, str], em: int, write: Callable[[float, float, str, str], None]
) -> None:
    """Draw a scale of colours at the right edge, with numbers beside it, and its name and unit above."""
    from PIL import Image

    low, high, label = scale
    column = image.width - 4 * em
    top = image.height // 4
    height = image.height // 2
    colours = colours_of_scale(np.linspace(high, low, height), low, high)
    image.paste(Image.fromarray(np.repeat(colours[:, None], em, axis=1)), (column, top))
    write(column + em, top - em, label, "rs")
    least_step = (high - low) * 2 * em / height  # numbers are at least two letters' heights apart
    power = 10.0 ** math.floor(math.log10(least_step))
    step = next(times * power for times in (1, 2, 5, 10) if times * power >= least_step)
    for number in range(math.ceil(low / step), math.floor(high / step) + 1):
        write(
            column - em // 2, top + height * (high - number * step) / (high - low), f"{number * step:g}", "rm"
        )

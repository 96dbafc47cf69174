"""Pictures and films of what a sensor sees, without a browser."""

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from itertools import chain, islice
from pathlib import Path
from threading import Event
from typing import Any, NamedTuple

import numpy as np

from vlp16emu.errors import InputError, MissingExtraError, OutputError
from vlp16emu.extras.camera import Orthographic, Pixels
from vlp16emu.extras.clouds.deskew import Trajectory
from vlp16emu.extras.clouds.scan import decode
from vlp16emu.extras.options import PictureLook, TrajectoryErrors
from vlp16emu.extras.plots import BACK, INK, plotted
from vlp16emu.extras.survey import species_of
from vlp16emu.extras.viewer.layers import Entries, coloured, colours_of_scale, layers_of_scan
from vlp16emu.extras.viewer.sweeps import Sweep, by_trajectory, sweeps_of_scene
from vlp16emu.output import OutputFile, spare
from vlp16emu.packets.layout import LASERS
from vlp16emu.run.emulator import Emulator
from vlp16emu.run.options import Span
from vlp16emu.types import F8, U1

_BACKGROUND = (14, 18, 24)
_RELIEF = 0.35
"""How dark a pixel gets per metre by which its neighbours are nearer: eye-dome lighting (Boucheny, thesis, Grenoble 2009)."""
_DARKEST = 0.3
_NEIGHBOUR_PX = 2

_NEEDED = {".png": "matplotlib", ".gif": "PIL", ".mp4": "imageio_ffmpeg"}  # library by suffix; of the extra 'picture'
_FRAMES_PER_S, _ELEVATION_DEG = 10, 32.0
_AROUND_M, _BELOW_M, _ABOVE_M = 22.0, 4.0, 22.0  # what is in the picture around, below and above the path of the sensor
_SHARE = 0.93  # share of the points in a sweep that the box of a capture in its sensor holds
_CIRCLES_M, _MOST_CIRCLES = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0), 6
_DEEP_M, _CIRCLE_RGB = -1e3, (58, 68, 82)  # circles of range about the sensor are behind all points
_SENSOR_RGB = (255, 70, 50)
_MOST_ENTRIES = 12
_MILLIONS = 100_000  # points from which on they are counted in millions
_FROM_DEG = 205.0  # bearing of the eye, unless another is wanted: light falls from the south
_STATIONS = 200  # number of places along a path
_FEWEST_COLUMNS = 800  # firing sequences of a revolution at 1200 rpm are some 900


@dataclass(frozen=True, slots=True)
class View:
    """Layout of a picture: the places of a sweep's points, and the words beside them."""

    size: tuple[int, int]
    pixels: Callable[[F8], Pixels]  # pixels of places (n, 3)
    places: Callable[[Sweep], F8]  # places (n, 3) of the points of a sweep that are shown, NaN for the others
    sensor: Callable[[Sweep], F8 | None] = lambda _: None
    """Place (3,) of the sensor, or None if it is not in the picture."""
    px_per_m: float | None = None
    """Scale of a view in which the points of all sweeps add up; None if it shows one sweep at a time."""
    dot_px: tuple[int, int] = (2, 2)
    circles_m: F8 | None = None  # (k, 3) points of circles of range
    labels: tuple[tuple[float, float, str], ...] = ()  # words at columns and rows, from below, of a still


class Drawing:
    """A picture of the points of sweeps, coloured by a layer, as a view lays them out; `species` are names by number."""

    def __init__(self, view: View, colour: str, species: Mapping[int, str]) -> None:
        self.view, self.colour, self._species, self.revolutions, self.points = view, colour, species, 0, 0
        self.clear()

    def clear(self) -> None:
        """Take away all points."""
        width, height = self.view.size
        self._near = np.full(height * width, -np.inf)
        self._rgb = np.zeros((height * width, 3), np.uint8)

    def add(self, pixels: Pixels, rgb: U1) -> None:
        """Draw points at pixels (n,) in colours (n, 3); what lies outside is left out."""
        width, height = self.view.size
        order = np.argsort(pixels[2], kind="stable")
        column, row, near, rgb = *(of[order] for of in pixels), rgb[order]
        for x in range(self.view.dot_px[0]):
            for y in range(self.view.dot_px[1]):
                inside = (column + x >= 0) & (column + x < width) & (row + y >= 0) & (row + y < height)
                pixel = (row[inside] + y) * width + column[inside] + x
                in_front = near[inside] > self._near[pixel]
                # Points come by nearness, and of several at one pixel numpy keeps the last.
                self._near[pixel[in_front]] = near[inside][in_front]
                self._rgb[pixel[in_front]] = rgb[inside][in_front]

    def image(self) -> U1:
        """Return the picture (height, width, 3), with relief."""
        width, height = self.view.size
        near = self._near.reshape(height, width)
        drawn = np.isfinite(near)
        behind, flat = np.zeros((height, width)), np.where(drawn, near, -1e6)
        for axis in (0, 1):
            for step in (-_NEIGHBOUR_PX, _NEIGHBOUR_PX):
                behind += np.clip(np.roll(flat, step, axis) - flat, 0.0, 2.0)
        light = np.maximum(np.exp(-_RELIEF * behind), _DARKEST)
        rgb = np.where(drawn[..., None], self._rgb.reshape(height, width, 3) * light[..., None], _BACKGROUND)
        return np.rint(rgb).astype(np.uint8)

    def images(self, sweeps: Iterator[Sweep], stop: Event) -> Iterator[Sweep]:
        """Draw sweeps, and yield each when it is drawn."""
        view = self.view
        for sweep in sweeps:
            if view.px_per_m is None:
                self.clear()
            if view.circles_m is not None:
                self.add(view.pixels(view.circles_m), np.full(view.circles_m.shape, _CIRCLE_RGB, np.uint8))
            place = view.places(sweep)
            shown = ~np.isnan(place[:, 0])
            self.add(view.pixels(place[shown]), coloured(sweep.scan, self.colour, self._species)[0][shown])
            self.points += int(shown.sum())
            self.revolutions += 1
            yield sweep
            if stop.is_set():
                return

    def marked(self, sweep: Sweep) -> U1:
        """Return the picture with the place of the sensor in it."""
        image = self.image()
        if (sensor := self.view.sensor(sweep)) is not None:
            (column,), (row,), _ = self.view.pixels(sensor[None])
            image[max(row - 4, 0) : max(row + 5, 0), max(column - 4, 0) : max(column + 5, 0)] = _SENSOR_RGB
        return image


def check_suffix(path: Path) -> None:
    """Refuse a file that cannot be drawn.

    OutputError if the suffix is not one of .png, .gif and .mp4; MissingExtraError if the library that writes such files is not installed.
    """
    suffix = path.suffix.lower()
    if suffix not in _NEEDED:
        raise OutputError(str(path), f"found the ending {suffix}", ", ".join(_NEEDED))
    for library in {"matplotlib", "PIL", _NEEDED[suffix]}:
        if find_spec(library) is None:
            name = {"PIL": "pillow", "imageio_ffmpeg": "imageio-ffmpeg"}.get(library, library)
            raise MissingExtraError(name, "picture", f"a picture in {suffix}")


class Source(NamedTuple):
    """Sweeps of a picture, and what surrounds them."""

    sweeps: Iterator[Sweep]  # one after another; memory does not grow with them
    way_m: F8 | None  # (k, 3) path of the sensor; None to look around the origin
    rings: int  # number of lasers of the sensor
    species: Mapping[int, str]  # names by number
    inputs: Collection[Path]  # files that are read, which the picture may not replace


def source_of_capture(capture: Path, trajectory: Path | None, span: Span, *, whole: bool) -> Source:
    """Return the revolutions of a capture, or unless `whole` the first one; those beyond the poses of a trajectory are left out.

    Without a trajectory points are as in the sensor.
    """
    way, way_m, inputs = None, None, [capture]
    if trajectory is not None:
        way, inputs = Trajectory(trajectory, 1, TrajectoryErrors()), [capture, trajectory]
        begin_s, end_s = way.span_s
        way_m = way.poses_at((1e9 * np.linspace(begin_s + 1e-3, end_s - 1e-3, _STATIONS)).astype(np.int64))[1]

    def sweeps() -> Iterator[Sweep]:
        first_ns, stop_s = None, math.inf if span.duration_s is None else span.start_s + span.duration_s
        for scan in decode(capture):
            first_ns = scan.start_ns if first_ns is None else first_ns
            since_s = (scan.start_ns - first_ns) / 1e9
            if since_s >= stop_s:
                return
            if since_s >= span.start_s and (way is None or way.has(scan.t_ns).all()):
                yield by_trajectory(scan, way)

    return Source(islice(sweeps(), None if whole else 1), way_m, LASERS, {}, inputs)


def source_of_scene(emulator: Emulator, span: Span) -> Source:
    """Return the revolutions of a scene's first sensor, with labels."""
    scenario, parts = emulator.scenario, emulator.parts
    ends_s = scenario.span_s(span.start_s, span.duration_s, where="--start")
    t_ns = scenario.start_ns + (np.linspace(*ends_s, _STATIONS) * 1e9).astype(np.int64)
    way_m, rings = parts.motion.poses_at(t_ns).world_p_body_m, len(parts.units[0].head.beams.elevation_deg)
    sweeps = sweeps_of_scene(emulator, span.start_s, span.duration_s)
    return Source(sweeps, way_m, rings, species_of(parts.world), emulator.files)


def draw_picture(source: Source, path: Path, look: PictureLook, stop: Event) -> dict[str, Any]:
    """Draw what accumulates over revolutions as a picture, or how it does as a film; other views draw them one by one.

    InputError if there is no revolution, or none with such a layer; OutputError, MissingExtraError as `check_suffix`.

    Parameters
    ----------
    path : .png, .gif or .mp4
    stop : ends the picture between two revolutions; before the first one with a `KeyboardInterrupt`
    """
    sweeps, way_m, rings, species, inputs = source
    spare(inputs, path)
    check_suffix(path)
    suffix = path.suffix.lower()
    first = next(sweeps, None)
    if first is None:
        if stop.is_set():
            raise KeyboardInterrupt
        raise InputError("picture", "no whole revolution", "at least one in the span")
    known = layers_of_scan(first.scan)
    colour = look.colour or ("natural" if "natural" in known else "reflectivity")
    if colour not in known:
        raise InputError("--colour", f"found {colour}", ", ".join(known))
    drawing = Drawing(_view(look, first, way_m, rings), colour, species)
    one_by_one = suffix == ".png" and drawing.view.px_per_m is None
    images = drawing.images(chain([first], islice(sweeps, 0) if one_by_one else sweeps), stop)
    with OutputFile(path) as output, output.writing() as file:
        if suffix == ".png":
            for _ in images:
                pass
            _still(file, drawing, coloured(first.scan, colour, species)[1])
        else:
            _film(file, (drawing.marked(sweep) for sweep in images), look, suffix)
    made = {"file": str(path), "revolutions": drawing.revolutions, "points": drawing.points, "colour": colour}
    return made | {"bytes": path.stat().st_size, "interrupted": stop.is_set()}


def _view(look: PictureLook, first: Sweep, way_m: F8 | None, rings: int) -> View:
    if look.view == "image":
        return laser_rows(look.size, rings)
    if look.view == "sweep":
        return from_above(look.size, float(np.quantile(first.scan.distance_m, _SHARE)))
    if way_m is None:
        spread = np.quantile(np.abs(first.world_m), _SHARE, axis=0)
        low, high = -spread, spread
    else:
        low = way_m.min(axis=0) - np.array([_AROUND_M, _AROUND_M, _BELOW_M])
        high = way_m.max(axis=0) + np.array([_AROUND_M, _AROUND_M, _ABOVE_M])
    # From above at a slant; points beside the box would hide what is near the path.
    box_m, from_deg = np.stack([low, high]), _FROM_DEG if look.from_deg is None else look.from_deg
    camera = Orthographic.around(box_m, from_deg, _ELEVATION_DEG, look.size)

    def sensor(sweep: Sweep) -> F8 | None:
        pose = sweep.scan.world_T_sensor
        return None if pose is None else pose[:3, 3]

    return View(look.size, camera.pixels, lambda sweep: _inside(box_m, sweep.world_m), sensor, camera.px_per_m)


def _inside(box_m: F8, places: F8) -> F8:
    inside = ((places >= box_m[0]) & (places <= box_m[1]))[:, :2].all(axis=1)
    return np.where(inside[:, None], places, np.nan)


def from_above(size: tuple[int, int], radius_m: float) -> View:
    """Return a view of a sweep from straight above to a radius, azimuth 0 upwards, with circles of range."""
    width, height = size
    corner_m = radius_m * np.array([width, height, height]) / min(width, height)
    box_m = np.stack([-corner_m, corner_m])
    camera = Orthographic.around(box_m, 180.0, 90.0, size)
    turn = np.linspace(0.0, 2.0 * np.pi, 4 * max(width, height))
    step_m = next((m for m in _CIRCLES_M if radius_m < _MOST_CIRCLES * m), _CIRCLES_M[-1])
    radii_m = np.arange(step_m, np.hypot(*corner_m[:2]), step_m)
    x, y = np.outer(radii_m, np.sin(turn)).ravel(), np.outer(radii_m, np.cos(turn)).ravel()
    column, row, _ = camera.pixels(np.outer(radii_m, [math.sqrt(0.5), math.sqrt(0.5), 0.0]))  # ahead, to the right
    labels = tuple(
        (x + 4, height - y + 4, f"{one:g} m")
        for x, y, one in zip(column.tolist(), row.tolist(), radii_m, strict=True)
        if 30 < y < height - 30 and 0 < x < width
    )

    def places(sweep: Sweep) -> F8:
        ahead, left, up = sweep.scan.xyz_m.T
        return _inside(box_m, np.column_stack([-left, ahead, up]).astype(np.float64))

    circles_m = np.column_stack([x, y, np.full(len(x), _DEEP_M)])
    return View(size, camera.pixels, places, lambda _: np.zeros(3), circles_m=circles_m, labels=labels)


def laser_rows(size: tuple[int, int], rings: int) -> View:
    """Return a view of a sweep as the sensor measures it: a row for each laser, the highest above, azimuths from the left."""
    width, height = size
    left, top = round(0.06 * width), round(0.1 * height)
    wide, tall = round(0.85 * width), height - 2 * top
    below, per_ring = height - top - tall - 20, tall / rings
    azimuths = ((left + deg * wide / 360.0, below, f"{deg}\N{DEGREE SIGN}") for deg in range(0, 360, 45))
    ends = ((8, height - top - (rings - n - 0.4) * per_ring, f"ring {n}") for n in (0, rings - 1))

    def pixels(place: F8) -> Pixels:
        """Return the pixels of azimuth (deg), ring and nearness (n, 3)."""
        azimuth_deg, ring, near = place.T
        column = left + np.floor(azimuth_deg * wide / 360.0).astype(np.int64)
        return column, top + (rings - 1 - ring.astype(np.int64)) * tall // rings, near

    def places(sweep: Sweep) -> F8:
        scan = sweep.scan
        # Of several returns the nearest is in front, by so little that none shades another.
        return np.column_stack([scan.azimuth_deg % 360.0, scan.ring, -1e-6 * scan.distance_m])

    dot_px = 1 + wide // _FEWEST_COLUMNS, -(-tall // rings)
    return View(size, pixels, places, dot_px=dot_px, labels=(*azimuths, *ends))


def _film(file: Any, frames: Iterator[U1], look: PictureLook, suffix: str) -> None:
    if suffix == ".gif":
        from PIL import Image

        made = (Image.fromarray(frame) for frame in frames)
        next(made).save(file, "GIF", save_all=True, append_images=made, duration=1000 // _FRAMES_PER_S, loop=0)
        return
    from imageio_ffmpeg import write_frames

    # ffmpeg writes by name.
    writer = write_frames(file.name, look.size, fps=_FRAMES_PER_S, macro_block_size=2, output_params=["-f", "mp4"])
    writer.send(None)
    for frame in frames:
        writer.send(np.ascontiguousarray(frame))
    writer.close()


def _still(file: Any, drawing: Drawing, entries: Entries) -> None:
    """Write a picture with its legend or scale of colours, and a bar of ten metres if points add up."""
    view, (width, height) = drawing.view, drawing.view.size
    many, colour = drawing.points, drawing.colour
    points = f"{many / 1e6:.2f} million" if many >= _MILLIONS else f"{many:,}".replace(",", " ")
    which = " of a revolution" if view.px_per_m is None else ""
    shown_by = "in natural colours" if colour == "natural" else f"by {colour}"
    with plotted(file, (width, height), layout=None) as figure:
        axes = figure.add_axes((0, 0, 1, 1))
        axes.imshow(drawing.image(), extent=(0, width, 0, height), interpolation="none")
        axes.set(xlim=(0, width), ylim=(0, height))
        axes.axis("off")
        text = partial(axes.text, fontsize=10, bbox={"facecolor": BACK, "edgecolor": "none", "alpha": 0.7, "pad": 2.0})
        if view.px_per_m is not None:
            axes.plot([30, 30 + 10 * view.px_per_m], [30, 30], color=INK, lw=2.5, solid_capstyle="butt")
            text(30, 38, "10 m")
        for column, up, words in view.labels:
            text(column, up, words)
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

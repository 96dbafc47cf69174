"""The public face: a scene's scans as arrays, into a capture, or over UDP."""

from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import InputError, spare
from vlp16emu.labels import label_scheme
from vlp16emu.points import PointCloud, scans_of, world_T_sensor, write_cloud
from vlp16emu.scan import Scan
from vlp16emu.sinks import TruthTo
from vlp16emu.streams import Streams

if TYPE_CHECKING:
    from vlp16emu.images import ImageRun


_SHORTEST_S = 0.001
"""Between two images."""


class Emulator(Streams):
    """A sensor, or several on one carrier, in the world of a scene.

    Nothing random is drawn but from the scene's seed: the same scene and settings give the same scans and the same
    bytes, whatever the threads.

    Parameters
    ----------
    scene : name (see `vlp16emu scenes`), path of a .toml file, its tables as a dictionary, or a scenario
    settings : values of the scene that are changed, by key: `{"sensor.rpm": 1200, "seed": 7}`
    ideal : a sensor without errors: beams without width, no noise, clear air
    threads : workers, 0 for one per core; they change the speed only
    audit : cast 0.05 % of the pulses of recordings and streams again, to estimate their error; not of a live run
    like : another emulator; where both go the same way through the same world, what that one has grown and built is used
        again. Never changes a byte.

    Raises
    ------
    InputError
        where the scene cannot be read, or a part of it cannot be made

    Examples
    --------
    >>> from vlp16emu import Emulator
    >>> emulator = Emulator("static_bench", {"sensor.rpm": 1200, "seed": 7})
    >>> scans = list(emulator.scans(duration_s=0.1, truth=True))
    >>> len(scans), scans[0].xyz_m.shape, scans[0].world_T_sensor.shape
    (2, (14464, 3), (4, 4))
    """

    def scans(
        self, *, start_s: float = 0.0, duration_s: float | None = None, unit: int = 1, truth: bool = False
    ) -> Iterator[Scan]:
        """Whole revolutions of a sensor, without going through packets: distances are not on their 2 mm grid.

        Parameters
        ----------
        start_s : since the first pulse
        duration_s : until the end of the scene if left out; begun revolutions at both ends are left out
        unit : which sensor of a rig, from 1
        truth : whether scans have labels

        Raises
        ------
        InputError
            where there is no such unit
        TrajectoryError
            where the walk is over before the span
        """
        return scans_of(self, self._number(unit), self.scenario.span_s(start_s, duration_s), truth=truth)

    def world_T_sensor(self, t_ns: NDArray[np.int64], *, unit: int = 1) -> NDArray[np.float64]:
        """(n, 4, 4) poses of a sensor at instants (n,) UTC; they take `Scan.xyz_m` to the world."""
        return world_T_sensor(self.parts.units[self._number(unit)], t_ns)

    def write_points(
        self,
        path: str | Path,
        *,
        start_s: float = 0.0,
        duration_s: float | None = None,
        unit: int = 1,
        truth: bool = False,
        labels: str | None = None,
        truth_to: str | Path | TruthTo | None = None,
        progress: Callable[[float], None] = lambda _: None,
        stop: Event | None = None,
    ) -> PointCloud:
        """Write points in the world and in the sensor's frame, for a sensor of any beam table.

        Parameters
        ----------
        path : .npz, .ply, .csv, .pcd, .las or .laz by its suffix; overwritten if it exists
        start_s, duration_s, progress, stop : as of `record`
        unit : which sensor of a rig, from 1
        truth : whether points have labels
        labels : scheme of labels beside them: "for-instance", "digiforests", "asprs" or "semantickitti"
        truth_to : folder for the ground truth of the run, as `truth` of `record`

        Raises
        ------
        InputError
            where there is no such unit or scheme, or the suffix names no format
        MissingExtraError
            where the library for a format is not there
        OutputError
            where file or folder cannot be written, or are an input of the scene
        TrajectoryError
            where the walk is over before the span
        RunError
            where the disk is full; the file is not complete
        """
        spare(self._files, Path(path))
        scheme = None if labels is None else label_scheme(labels)
        span_s, stop = self.scenario.span_s(start_s, duration_s), stop or Event()
        with self.windows.stopped_by(stop):
            return write_cloud(
                self,
                self._number(unit),
                Path(path),
                span_s,
                truth=truth,
                labels=scheme,
                scene=self.name,
                progress=self._with_truth_so_far(progress, span_s, truth_to),
                stop=stop,
            )

    def write_images(
        self,
        folder: str | Path,
        *,
        kind: str = "panorama",
        size: tuple[int, int] | None = None,
        fov_deg: float | None = None,
        every_s: float = 1.0,
        start_s: float = 0.0,
        duration_s: float | None = None,
        unit: int = 1,
        progress: Callable[[float], None] = lambda _: None,
        stop: Event | None = None,
    ) -> "ImageRun":
        """Write depth, labels and colours as images from the place of a sensor, each of one instant.

        Parameters
        ----------
        folder : new or empty
        kind : "panorama" or "pinhole", which looks to the sensor's azimuth 0
        size : width and height in pixels; 2048 x 512 of a panorama, 1024 x 768 of a pinhole camera, if left out
        fov_deg : of a pinhole camera, from left to right; 90 if left out
        every_s : from image to image
        start_s, duration_s, progress, stop : as of `record`
        unit : which sensor of a rig, from 1

        Raises
        ------
        InputError
            where there is no such unit or camera
        MissingExtraError
            where Pillow or OpenEXR is not there
        OutputError
            where the folder cannot be written, or is not empty
        TrajectoryError
            where the walk is over before the span
        RunError
            where the disk is full; the images before are kept
        """
        if not every_s >= _SHORTEST_S:
            raise InputError("--every", f"found {every_s:g}", f"a number of seconds from {_SHORTEST_S:g}")
        from vlp16emu.images import Camera, write_images  # here: few runs need them

        camera = Camera.of(kind, size, fov_deg)
        span_s, stop = self.scenario.span_s(start_s, duration_s), stop or Event()
        with self.windows.stopped_by(stop):
            return write_images(
                self,
                self._number(unit),
                Path(folder),
                span_s,
                camera,
                every_s=every_s,
                scene=self.name,
                threads=self._threads,
                progress=progress,
                stop=stop,
            )

    def write_truth(
        self,
        to: str | Path | TruthTo,
        *,
        start_s: float = 0.0,
        duration_s: float | None = None,
        progress: Callable[[float], None] = lambda _: None,
        stop: Event | None = None,
    ) -> float:
        """Write the ground truth that `record` writes beside a run, byte for byte, without casting a pulse.

        Parameters
        ----------
        to : folder
        start_s, duration_s : as of `record`
        progress : called with the simulated seconds so far, second by second
        stop : ends it from another thread

        Returns
        -------
        Simulated seconds

        Raises
        ------
        OutputError
            where the folder cannot be written, or holds an input of the scene
        ScenarioError
            where poses of packets are wanted of a sensor that has none
        TrajectoryError
            where the walk is over before the span
        RunError
            where the disk is full; the lines before are kept
        """
        begin_s, stop_s = span_s = self.scenario.span_s(start_s, duration_s)
        self._span_ns(*span_s)  # checks the span before the folder is touched
        done_s, stop = 0.0, stop or Event()
        with self._with_truth_so_far(progress, span_s, to) as so_far:
            while done_s < stop_s - begin_s and not stop.is_set():
                done_s = min(done_s + 1.0, stop_s - begin_s)
                so_far(done_s)
        return done_s

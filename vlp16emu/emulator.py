"""The public face: a scene's scans as arrays, into a capture, or over UDP."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vlp16emu.accuracy import Audit
from vlp16emu.chain.chain import Chain
from vlp16emu.errors import InputError, spare
from vlp16emu.points import PointCloud, scans_of, world_T_sensor, write_cloud
from vlp16emu.recording import Recording, record_packets
from vlp16emu.scan import Scan
from vlp16emu.scenario import Scenario, find, load
from vlp16emu.scenario.find import named_files
from vlp16emu.sinks import (
    LOOK_AHEAD_PACKETS,
    LOOPBACK,
    FellBehind,
    Late,
    Outlets,
    Pacer,
    RigSink,
    SinkByKind,
    TruthTo,
    UnderWay,
    check_ending,
    stream,
)
from vlp16emu.streaming import Engine, Http, Streamed, summed_up, with_outlets
from vlp16emu.types import Packet
from vlp16emu.units import S_NS

if TYPE_CHECKING:
    from vlp16emu.truth import Truth

__all__ = ["Emulator"]

_NONE = Outlets()


class Emulator(Chain):
    """A sensor, or several on one carrier, in the world of a scene.

    Nothing random is drawn but from the scene's seed: the same scene and settings give the same scans and the same
    bytes, whatever the threads.

    Parameters
    ----------
    scene : name (see `vlp16emu scenes`), path of a .toml file, its tables as a dictionary, or a scenario
    settings : values of the scene that are changed, by key: `{"sensor.rpm": 1200, "seed": 7}`
    ideal : a sensor without errors: beams without width, no noise, clear air
    threads : workers, 0 for one per core; they change the speed only
    audit : cast 0.05 % of the pulses of recordings and streams again, to estimate their error

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

    def __init__(
        self,
        scene: str | Path | Mapping[str, Any] | Scenario,
        settings: Mapping[str, object] | Sequence[str] = (),
        *,
        ideal: bool = False,
        threads: int = 0,
        audit: bool = False,
    ) -> None:
        scenario = load(scene, settings, ideal=ideal)
        self.audit = Audit.of(scenario) if audit else None
        super().__init__(scenario, threads=threads, audit=self.audit)
        self.name = str(scene) if isinstance(scene, str | Path) else scenario.title
        own = [find(str(scene))] if isinstance(scene, str | Path) else []
        self._files = [*own, *named_files(scenario)]

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

    def record(
        self,
        path: str | Path,
        *,
        start_s: float = 0.0,
        duration_s: float | None = None,
        truth: str | Path | TruthTo | None = None,
        progress: Callable[[float], None] = lambda _: None,
        stop: Event | None = None,
    ) -> Recording:
        """Write data and position packets into a pcap file, in the frames of a real sensor.

        Parameters
        ----------
        path : .pcap, .cap, .dump, .dmp or without an ending; overwritten if it exists; `-` is standard output
        start_s : since the first pulse
        duration_s : until the end of the scene if left out
        truth : folder for the ground truth of the run: trajectory, GNSS, rig, scenario
        progress : called with the simulated seconds so far, packet by packet
        stop : ends the recording from another thread; the file is valid

        Raises
        ------
        OutputError
            where file or folder cannot be written, or are an input of the scene, or the name is that of another format
        ScenarioError
            where the sensor has no packets
        TrajectoryError
            where the walk is over before the span
        RunError
            where the disk is full; the packets before are kept
        """
        spare(self._files, Path(path))
        check_ending(Path(path))
        span_s, stop = self.scenario.span_s(start_s, duration_s), stop or Event()
        packets = self.packets(*span_s)  # checks the span before the file is touched
        with self.windows.stopped_by(stop):
            recording = record_packets(
                self,
                self._with_truth(packets, span_s, truth),
                Path(path),
                span_s,
                scene=self.name,
                progress=progress,
                stop=stop,
            )
        return replace(recording, audit=self.audit.finding if self.audit else None)

    def write_points(
        self,
        path: str | Path,
        *,
        start_s: float = 0.0,
        duration_s: float | None = None,
        unit: int = 1,
        truth: bool = False,
        truth_to: str | Path | TruthTo | None = None,
        progress: Callable[[float], None] = lambda _: None,
        stop: Event | None = None,
    ) -> PointCloud:
        """Write points in the world and in the sensor's frame, for a sensor of any beam table.

        Parameters
        ----------
        path : .npz, .ply or .csv by its suffix; overwritten if it exists
        start_s, duration_s, progress, stop : as of `record`
        unit : which sensor of a rig, from 1
        truth : whether points have labels
        truth_to : folder for the ground truth of the run, as `truth` of `record`

        Raises
        ------
        InputError
            where there is no such unit, or the suffix names no format
        OutputError
            where file or folder cannot be written, or are an input of the scene
        TrajectoryError
            where the walk is over before the span
        RunError
            where the disk is full; the file is not complete
        """
        spare(self._files, Path(path))
        span_s, stop = self.scenario.span_s(start_s, duration_s), stop or Event()
        with self.windows.stopped_by(stop):
            return write_cloud(
                self,
                self._number(unit),
                Path(path),
                span_s,
                truth=truth,
                scene=self.name,
                progress=self._with_truth_so_far(progress, span_s, truth_to),
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

    def stream(
        self,
        *,
        to: str = LOOPBACK,
        duration_s: float | None = None,
        truth: str | Path | TruthTo | None = None,
        speed: float = 1.0,
        late: Late | str = Late.PACE,
        as_sensor: bool = False,
        now: bool = False,
        http: Http | None = None,
        outlets: Outlets = _NONE,
        opened: Callable[[], None] = lambda: None,
        progress: Callable[[float], None] = lambda _: None,
        notify: Callable[[FellBehind], None] = lambda _: None,
        stop: Event | None = None,
    ) -> Streamed:
        """Send packets over UDP, each at its time; nothing leaves this machine unless `to` names another one.

        Parameters
        ----------
        to : receiver; may be a broadcast address
        duration_s : until the end of the scene if left out
        truth : as of `record`
        speed : simulated seconds per second
        late : `pace` keeps the spacing of packets that are late by more than 50 ms, and the delay; `skip` drops them
        as_sensor : send from the sensor's address, which this machine must have, with its headers
        now : move stamps and sentences by whole seconds into the present; truth stays at the time of the scene
        http : where the web interfaces of the sensors are, through which the stream is set; None for none
        outlets : what leaves beside the packets of the sensors: sentences and pulses of the receiver, inertial samples
        opened : called once before the first packet is computed, when the sockets are open
        progress : called with the simulated seconds so far, packet by packet
        notify : called each time that the stream falls behind
        stop : ends the stream from another thread

        Raises
        ------
        OutputError
            where the receiver is unknown or out of reach, or the sensor's address is not this machine's
        InputError
            where the present is wanted at another speed than its own
        ScenarioError
            where the sensor has no packets, or the scene no device that an outlet is for
        TrajectoryError
            where the walk is over before the span
        RunError
            where the system cannot send any more
        """
        stop = stop or Event()
        span_s, start_ns = self.scenario.span_s(0.0, duration_s), self.scenario.start_ns
        links = [unit.link for unit in self.parts.units]
        policy = Late(late)
        with (
            ExitStack() as stack,
            closing(Engine(self, *span_s, also=outlets.kinds)) as engine,
            self.windows.stopped_by(stop),
            self._with_truth(engine, span_s, truth) as packets,
            RigSink(links, to, as_sensor=as_sensor, sent=lambda ns: progress((ns - start_ns) / S_NS)) as sink,
            outlets.opened(self.scenario.imu) as ways,
        ):
            opened()
            report = stream(
                packets,
                SinkByKind(sink, ways) if ways else sink,
                Pacer(speed),
                begun=lambda under_way: self._serve(http, engine, sink, under_way, stack) if http else None,
                late=policy,
                notify=notify,
                go_on_from=engine.go_on_from,
                now=now,
                stop=stop,
                look_ahead_packets=LOOK_AHEAD_PACKETS * len(links) + outlets.look_ahead(self.scenario.imu),
            )
        found, how = self.audit.finding if self.audit else None, (self.name, to, speed, policy)
        streamed = summed_up(self, engine, report, sink.results, *how, audit=found)
        return with_outlets(streamed, ways, report.skipped + engine.skipped)

    def _serve(
        self, http: Http, engine: Engine, sink: RigSink, under_way: UnderWay, until: ExitStack
    ) -> None:
        """Serve the web interfaces, as sensors do once they are up."""
        from vlp16emu.control import Control, web_interfaces  # here: few streams have them

        until.enter_context(web_interfaces(Control(self, engine, sink, under_way), http))

    def _number(self, unit: int) -> int:
        """Place in the rig of a unit, from 0."""
        if not 1 <= unit <= (units := len(self.parts.units)):
            raise InputError("unit", f"found {unit}", f"1 to {units}, as the scene has {units} units")
        return unit - 1

    @contextmanager
    def _with_truth(
        self, packets: Iterator[Packet], span_s: tuple[float, float], to: str | Path | TruthTo | None
    ) -> Iterator[Iterator[Packet]]:
        """Packets whose truth is written as they are taken, where a folder is given."""
        with nullcontext() if to is None else self._truth(to, span_s) as truth:
            yield packets if truth is None else truth.beside(packets)

    @contextmanager
    def _with_truth_so_far(
        self,
        progress: Callable[[float], None],
        span_s: tuple[float, float],
        to: str | Path | TruthTo | None,
    ) -> Iterator[Callable[[float], None]]:
        """Progress of a run without packets, whose truth is written as it is called, where a folder is given."""

        def so_far(done_s: float) -> None:
            """Write what was true until then."""
            if truth is not None:
                truth.up_to(span_s[0] + done_s)
            progress(done_s)

        with nullcontext() if to is None else self._truth(to, span_s) as truth:
            yield so_far

    def _truth(self, to: str | Path | TruthTo, span_s: tuple[float, float]) -> "Truth":
        """Begin a folder of truth, beside the files that the run reads."""
        from vlp16emu.truth import Truth  # here: few runs need it

        place = to if isinstance(to, TruthTo) else TruthTo(Path(to))
        spare(self._files, place.scenario)
        return Truth(place, self, span_s)

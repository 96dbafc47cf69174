"""The public class: a scene as scans in arrays, as a capture, or over UDP."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from copy import copy
from dataclasses import replace
from pathlib import Path
from threading import Event
from typing import Protocol, Self, Unpack

import numpy as np
from numpy.typing import NDArray

from vlp16emu.doors import Part
from vlp16emu.engine import Engine, Parts
from vlp16emu.engine.engine import Job
from vlp16emu.engine.timeline import TruthOf
from vlp16emu.errors import InputError, TrajectoryError
from vlp16emu.output import spare
from vlp16emu.raycast.caster import Geometry
from vlp16emu.run.feed import PacketFeed
from vlp16emu.run.options import RecordKeys, RecordOptions, StreamKeys, StreamOptions, TruthPlace, TruthTo
from vlp16emu.run.part import StreamPart
from vlp16emu.run.record import record
from vlp16emu.run.report import AuditResult, Recording, Streamed
from vlp16emu.run.scene_stream import SceneStream
from vlp16emu.scenario import Scenario, find, load, named_files
from vlp16emu.trees import Table
from vlp16emu.types import Firings, Hits, Packet, Returns, Scan

Scene = str | Path | Table | Scenario
"""Name of a scene, path of a .toml file, its tables as a dictionary, or a scenario."""


class Audit(Protocol):
    """Tap that casts a sample of the pulses again."""

    def __call__(self, job: Job, firings: Firings, hits: Hits, geometry: Geometry) -> None:
        """Audit the drawn pulses of a block."""

    @property
    def finding(self) -> AuditResult:
        """Error found so far."""


class TruthWriter(Protocol):
    """Writer of the ground truth of a run."""

    def beside(self, packets: Iterable[Packet]) -> Iterator[Packet]:
        """Pass packets on, and write the ground truth up to them."""

    def up_to(self, since_s: float) -> None:
        """Write the ground truth up to a time since the first pulse, without packets of a run."""


class HasEngine(Protocol):
    """An emulator, or the feed of its packets in a stream."""

    @property
    def engine(self) -> Engine:
        """Engine that makes the packets, with the settings and events so far."""


class ScansOf(Protocol):
    """Function that returns the revolutions of a unit within a span."""

    def __call__(
        self, engine: Engine, number: int, span_s: tuple[float, float], *, truth: bool
    ) -> Iterator[Scan]:
        """Return whole revolutions; with labels if `truth`."""


AUDIT = Part[Callable[[Scenario], Audit]]("vlp16emu.extras.accuracy.audit:Audit")
TRUTH_OF_RECORDS = Part[TruthOf]("vlp16emu.extras.truth.slots:slots_of")
TRUTH = Part[Callable[[TruthTo, HasEngine, tuple[float, float]], AbstractContextManager[TruthWriter]]](
    "vlp16emu.extras.truth.truth:Truth"
)
SCANS = Part[ScansOf]("vlp16emu.extras.clouds.scan:scans_of")


class Emulator:
    """A sensor, or several on one carrier, in the world of a scene.

    All random numbers come from the scene's seed: the same scene and settings give the same scans and the
    same bytes, with any number of threads.

    Parameters
    ----------
    scene : name (see `vlp16emu scenes`), path of a .toml file, its tables as a dictionary, or a scenario
    settings : changed values of the scene by key: `{"sensor.rpm": 1200, "seed": 7}`
    ideal : a sensor without errors: beams without width, no noise, clear air
    threads : workers, 0 for one per core; they change the speed only
    audit : cast 0.05 % of the pulses of recordings and streams again, to estimate their error; not in a live
        run
    like : another emulator; if both follow the same path through the same world, its grown and built geometry
        is reused. Never changes a byte.

    Raises InputError if the scene cannot be read, or a part of it cannot be made.

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
        scene: Scene,
        settings: Mapping[str, object] | Sequence[str] = (),
        *,
        ideal: bool = False,
        threads: int = 0,
        audit: bool = False,
        like: "Emulator | None" = None,
    ) -> None:
        scenario = load(scene, settings, ideal=ideal)
        # The poses of a live run are not available when its pulses are cast a second time.
        wanted = audit and AUDIT.is_installed and not scenario.motion.takes_poses
        self.audit = AUDIT.load()(scenario) if wanted else None
        """Tap that casts a sample of the pulses again, an `extras.accuracy.audit.Audit`; None without an
        audit."""
        taps = [self.audit] if self.audit else []
        self.engine: Engine = Engine.of(
            scenario, threads=threads, taps=taps, like=like.engine if like else None
        )
        """Engine that makes the packets."""
        is_named = isinstance(scene, str | Path)
        self.name = str(scene) if is_named else scenario.title  # Name, path or title of the scene
        own = [scene if isinstance(scene, Path) else find(str(scene))] if is_named else []
        self.files = (*own, *named_files(scenario))
        """Input files of the run; no output replaces them."""

    @property
    def scenario(self) -> Scenario:
        """Scenario, which determines all bytes."""
        return self.engine.scenario

    @property
    def parts(self) -> Parts:
        """Sensors, carrier and world."""
        return self.engine.parts

    @property
    def finding(self) -> AuditResult | None:
        """Error found so far, an `AuditFinding`; None without an audit."""
        return self.audit.finding if self.audit else None

    def number(self, unit: int) -> int:
        """Return the index in the rig, from 0, of unit 1, 2 ....

        Raises InputError if there is no such unit.
        """
        if not 1 <= unit <= (units := len(self.parts.units)):
            expected = (
                "1, as the scene has one unit" if units == 1 else f"1 to {units}, the units of the scene"
            )
            raise InputError("unit", f"found {unit}", expected)
        return unit - 1

    def with_engine(self, engine: Engine) -> Self:
        """Return the same emulator with another engine."""
        other = copy(self)
        other.engine = engine
        return other

    def stopped_by(self, stop: Event) -> Self:
        """Return the same emulator for one run, which ends with CancelledError once `stop` is set."""
        return self.with_engine(self.engine.stopped_by(stop))

    def changed(self, settings: Mapping[str, object] | Sequence[str]) -> Self:
        """Return an emulator with changed settings; it shares the world if that stays the same."""
        scenario = load(self.scenario, settings)
        engine = self.engine
        if scenario == self.scenario:
            return self
        other = type(self)(scenario, threads=engine.threads, audit=self.audit is not None, like=self)
        other.name = self.name
        other.files = (*self.files, *other.files)
        return other.with_engine(replace(other.engine, truth_of=engine.truth_of))

    def with_truth_in(self, to: TruthTo | None) -> Self:
        """Return an emulator whose packets carry the ground truth of their records, if `to` requires it."""
        if to is None or not to.per_return:
            return self
        return self.with_engine(replace(self.engine, truth_of=TRUTH_OF_RECORDS.load()))

    @contextmanager
    def truth(
        self, to: TruthPlace | None, span_s: tuple[float, float], *, of: PacketFeed | None = None
    ) -> Iterator["TruthWriter | None"]:
        """Open the folder for the ground truth of a span, an `extras.truth.truth.Truth`; None without `to`.

        It is the ground truth of the feed `of`, with its events so far, or of the scene.
        """
        if (place := TruthTo.of(to)) is None:
            yield None
            return
        spare(self.files, place.scenario)
        with TRUTH.load()(place, of or self, span_s) as truth:
            yield truth

    def packets(self, start_s: float = 0.0, stop_s: float | None = None) -> Iterator[Packet]:
        """Return the packets of a span, in order of sending.

        They are due from `start_s` until before `stop_s` after the first pulse.

        Raises ScenarioError if the sensor has no packets; TrajectoryError if the span begins before the first
        pulse, or if the walk ends before the span.
        """
        return self.engine.packets(start_s, stop_s)

    def returns(
        self, start_s: float = 0.0, stop_s: float | None = None, unit: int = 1, *, truth: bool = False
    ) -> Iterator[Returns]:
        """Yield the returns of unit 1, 2 ... before packing, in whole blocks that cover the span.

        With `truth` they include the surfaces that reflected them. Raises InputError if there is no such
        unit; TrajectoryError if the walk ends before the span.
        """
        return self.engine.returns(start_s, stop_s, self.number(unit), truth=truth)

    def scans(
        self, *, start_s: float = 0.0, duration_s: float | None = None, unit: int = 1, truth: bool = False
    ) -> Iterator[Scan]:
        """Yield whole revolutions of a sensor, directly from the engine.

        Distances are not on the 2 mm grid of packets.

        Parameters
        ----------
        start_s : begin since the first pulse
        duration_s : duration, by default to the end of the scene; incomplete revolutions at both ends are
            left out
        unit : sensor of a rig, from 1
        truth : True for scans with labels

        Raises InputError if there is no such unit; TrajectoryError if the walk ends before the span.
        """
        span_s = self.scenario.span_s(start_s, duration_s)
        return SCANS.load()(self.engine, self.number(unit), span_s, truth=truth)

    def world_T_sensor(self, t_ns: NDArray[np.int64], *, unit: int = 1) -> NDArray[np.float64]:
        """Return poses (n, 4, 4) of a sensor at instants (n,) UTC.

        They transform `Scan.xyz_m` to the world.
        """
        return self.parts.units[self.number(unit)].world_T_sensor(t_ns)

    def record(
        self,
        path: str | Path,
        *,
        progress: Callable[[float], None] = lambda _: None,
        stop: Event | None = None,
        **options: Unpack[RecordKeys],
    ) -> Recording:
        """Write data and position packets into a pcap file, or a robot's topics into a bag.

        Frames in a pcap file are those of a real sensor.

        Parameters
        ----------
        path : .pcap, .cap, .dump, .dmp or without an ending; overwritten if it exists; `-` is standard
            output; a bag with .mcap, .bag, or as a new folder with a slash at its end
        progress : called with the simulated seconds so far, packet by packet
        stop : ends the recording from another thread; the file is valid, and there is none before the first
            packet
        options : fields of `RecordOptions`: `start_s`, `duration_s`, `split`, `truth`, `bag`

        Raises InputError for a wrong option; OutputError if file or folder cannot be written, or are an input
        of the scene, or if the name belongs to another format; ScenarioError if the sensor has no packets;
        TrajectoryError if the walk ends before the span; RunError if the disk is full; the packets before it
        are kept; CancelledError, and earlier files stay, if `stop` is set before the first packet.
        """
        return record(self, path, RecordOptions.from_fields(options), progress=progress, stop=stop)

    def stream(
        self, *, parts: Sequence[StreamPart] = (), stop: Event | None = None, **options: Unpack[StreamKeys]
    ) -> Streamed:
        """Send packets over UDP, each at its time; nothing leaves this machine unless `to` names another one.

        Parameters
        ----------
        parts : watch the stream, in their order
        stop : ends the stream from another thread
        options : fields of `StreamOptions`

        Raises OutputError if the receiver is unknown or unreachable, or the sensor's address is not this
        machine's; InputError for a wrong option, options that exclude each other, or poses for a scene that
        is not live; ScenarioError if the sensor has no packets; TrajectoryError if the walk ends before the
        span; RunError if the system can no longer send.
        """
        stream = SceneStream(self, StreamOptions.from_fields(options), stop=stop)
        for part in parts:
            stream.add(part)
        stream.run()
        return stream.result

    def put_pose(
        self, position_m: Sequence[float], quaternion: Sequence[float], t_ns: int | None = None
    ) -> bool:
        """Put a pose into a live scene, from any thread; parameters, result and errors as in `PoseInput.put`.

        Raises TrajectoryError if the scene is not live.
        """
        if (put := getattr(self.parts.carrier, "put_pose", None)) is None:
            raise TrajectoryError("motion.kind", f'found "{self.scenario.motion.kind}"', '"live"')
        taken: bool = put(position_m, quaternion, t_ns)
        return taken

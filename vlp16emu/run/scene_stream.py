"""The stream of a scene over UDP."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import asdict, replace
from threading import Event
from typing import TYPE_CHECKING, Protocol, TypeVar

from vlp16emu.doors import Part
from vlp16emu.errors import InputError
from vlp16emu.output import write_json
from vlp16emu.packets import Link
from vlp16emu.run.feed import PacketFeed
from vlp16emu.run.options import PosesIn, StreamOptions, TruthTo
from vlp16emu.run.part import OutletPart, PosePart, StreamPart, WebPart
from vlp16emu.run.report import About, Streamed, UnitSent
from vlp16emu.run.stream import State, Stream, StreamReport
from vlp16emu.scenario import Scenario
from vlp16emu.sinks import LOOK_AHEAD_PACKETS, FellBehind, Late, Pacer
from vlp16emu.types import Packet, PacketKind

if TYPE_CHECKING:
    from vlp16emu.run.emulator import Emulator

_Part = TypeVar("_Part", bound=StreamPart)


class Preparation(Protocol):
    """Function that records a whole run into a file, and yields its packets."""

    def __call__(
        self, emulator: "Emulator", options: StreamOptions, *, progress: Callable[[float], None], stop: Event
    ) -> Iterator[Packet]:
        """Return the packets of `options.prepare`."""


class Measured(Protocol):
    """What a measurement of this machine has found."""

    @property
    def line(self) -> str:
        """The chosen settings in a line for people."""


class Outlooks(Protocol):
    """The class of outlooks: what this machine can compute of a scene."""

    def measured(self, emulator: "Emulator", speed: float, stop: Event) -> "tuple[Emulator, Measured]":
        """Measure this machine, and return the emulator with settings that keep up."""

    def advice_after(self, times: Sequence[FellBehind], scenario: Scenario, speed: float) -> list[str]:
        """Return options with which a late engine keeps up."""


_LATE = {
    Late.PACE: "the delay stays, at the sensor's own spacing (--late pace)",
    Late.SKIP: "late packets are dropped until the stream is at now (--late skip)",
}


OUTLETS = Part[Callable[["SceneStream"], OutletPart]]("vlp16emu.extras.bench.outlets:OutletSinks")
GPS_IN = Part[Callable[["SceneStream"], StreamPart]]("vlp16emu.extras.bench.gps_in:GpsReader")
WEB = Part[Callable[["SceneStream"], WebPart]]("vlp16emu.extras.bench.control:WebInterfaces")
LIVE = Part[Callable[["SceneStream"], PosePart]]("vlp16emu.extras.live.flight:Flight")
PREPARED = Part[Preparation]("vlp16emu.extras.replay:prepared")
OUTLOOK = Part[Outlooks]("vlp16emu.extras.outlook:Outlook")
FREE_PORTS = Part[Callable[[int], AbstractContextManager[list[int]]]]("vlp16emu.extras.free_ports:free_ports")


class SceneStream(Stream):
    """Stream of a scene, whose ports are reserved and whose sockets are open once it is made.

    Parameters
    ----------
    emulator : the scene
    options : receiver, span, and what accompanies the packets
    look_ahead : packets of a sensor that are computed before the first one is sent
    stop : ends the stream from another thread

    Raises the errors of `Emulator.stream`.
    """

    def __init__(
        self,
        emulator: "Emulator",
        options: StreamOptions,
        *,
        look_ahead: int = LOOK_AHEAD_PACKETS,
        stop: Event | None = None,
    ) -> None:
        if emulator.scenario.motion.takes_poses and options.poses is None:
            options = replace(options, poses=PosesIn())
        self.options = options
        self.truth = TruthTo.of(options.truth)
        self.host, _ = options.receiver
        _check(options, self.truth)
        late = Late.SKIP if options.poses else Late(options.late)  # later poses would wait for late packets
        super().__init__((), {}, Pacer(options.speed), late=late, now=options.now, stop=stop)
        with self._opening():
            self._open(emulator, look_ahead)

    def _open(self, emulator: "Emulator", look_ahead: int) -> None:
        """Reserve ports, and open parts and sinks: a wrong address fails before any casting."""
        options = self.options
        on_ports = self._opened.enter_context(_on_ports(emulator.with_truth_in(self.truth), options))
        self.emulator = on_ports.stopped_by(self.stop)
        scenario = self.emulator.scenario
        self.span_s = scenario.span_s(0.0, options.duration_s)
        # A real receiver changes packets before parts that are added see them. The clock of a live run starts
        # last, when all else has begun.
        self.outlets = self._part(OUTLETS, options.outlets)
        self.gps_in = self._part(GPS_IN, options.gps_in)
        self.web = self._part(WEB, options.http)
        self.flight = self._part(LIVE, options.poses)
        self.feed = self._new_feed()
        self.udp = self._open_udp(self.links, options)
        of_unit = self.flight.look_ahead if self.flight else look_ahead
        self._look_ahead = len(self.links) * of_unit
        if self.outlets:
            self._sinks |= self.outlets.sinks
            self._look_ahead += self.outlets.look_ahead

    def _part(self, part: Part[Callable[["SceneStream"], _Part]], option: object) -> _Part | None:
        """Add a part that an option asks for; None without the option."""
        if option is None:
            return None
        made = part.load()(self)
        self.add(made)
        return made

    @property
    def links(self) -> list[Link]:
        """Addresses and ports of the sensors."""
        return [unit.link for unit in self.emulator.parts.units]

    def measure(self) -> None:
        """Measure this machine for some seconds, and set beam and reach that leave a fifth of its time free.

        A line names them; given to `vlp16emu record --set` they give the same bytes.
        """
        self._enter(State.MEASURING)
        self.say("keep-up: measuring this machine")
        with self._interruptible():
            self.emulator, outlook = OUTLOOK.load().measured(self.emulator, self.pacer.speed, self.stop)
            self.feed = self._new_feed()
            self.say(outlook.line)
        self._enter(State.OPENED)

    def run(self) -> StreamReport:
        """Send the packets, and write the time of the first one to the ground truth; see `Stream.run`."""
        report = super().run()
        if self.truth and report.first:  # so that live results can be compared with the truth
            times = {"moved_s": report.moved_s, "speed": self.pacer.speed, "packet_0": asdict(report.first)}
            write_json(self.truth.folder / "time.json", times)
        return report

    @property
    def report(self) -> StreamReport:
        """Report so far, with the packets that the engine has skipped."""
        report = super().report
        return replace(report, skipped=report.skipped + self.feed.skipped)

    @property
    def result(self) -> Streamed:
        """Result of the stream, once it is closed."""
        report = self.report
        emulator = self.emulator.with_engine(self.feed.engine)  # with settings and events of the run
        ran_s = (0.0, report.simulated_s)
        units = zip(emulator.parts.units, self.udp.sent, strict=True)
        outlets = self.outlets.result if self.outlets else {}
        return Streamed(
            about=About.of(emulator.name, emulator.scenario),
            to=self.host,
            speed=self.pacer.speed,
            late=self.late,
            units=tuple(UnitSent.of(unit, sent, ran_s) for unit, sent in units),
            sent=report,
            keeps_up_with=tuple(self._advice(report.behind)),
            audit=emulator.finding,
            live=self.flight and self.flight.result,
            gps_in=self.gps_in and self.gps_in.result,
            gps_out=outlets.get(PacketKind.NMEA),
            imu_out=outlets.get(PacketKind.IMU),
        )

    def _behind_line(self, behind: FellBehind) -> str:
        """Return the line with cause, treatment of late packets, and options that would keep up."""
        line = f"{super()._behind_line(behind)}, as {behind.cause}; {_LATE[self.late]}"
        advice = self._advice([behind])
        return f"{line}; to keep up: {', or '.join(advice)}" if advice else line

    def _advice(self, times: Sequence[FellBehind]) -> list[str]:
        """Return options of `vlp16emu stream` with which the engine keeps up, each sufficient alone."""
        if not times or not OUTLOOK.is_installed:
            return []
        return OUTLOOK.load().advice_after(times, self.emulator.scenario, self.pacer.speed)

    def _new_feed(self) -> PacketFeed:
        options = self.options
        prompt = options.http is not None  # settings from there should take effect soon
        engine = replace(self.emulator.engine, prompt=prompt)
        also = self.outlets.kinds if self.outlets else ()
        return PacketFeed(engine, *self.span_s, also=also)

    @contextmanager
    def _source(self, progress: Callable[[float], None]) -> Iterator[Iterable[Packet]]:
        """Yield prepared packets, or those of the feed, with the ground truth written beside them."""
        if self.options.prepare:
            yield PREPARED.load()(self.emulator, self.options, progress=progress, stop=self.stop)
            return
        with closing(self.feed), self.emulator.truth(self.truth, self.span_s, of=self.feed) as writer:
            yield writer.beside(self.feed) if writer else self.feed

    def _go_on_from(self, due_ns: int) -> None:
        if self.flight:  # nothing is computed far ahead
            due_ns = self.pacer.due_in_ns(self.flight.lead_ns)
        if not self.options.prepare:
            self.feed.go_on_from(due_ns)


def _check(options: StreamOptions, truth: TruthTo | None) -> None:
    """Refuse options that exclude each other."""
    http = options.http
    outlets = options.outlets
    fine = truth and (truth.per_packet or truth.per_return)
    for given, option, other, excluded in (
        (options.prepare, "--prepare", "--http", http),
        (
            options.prepare,
            "--prepare",
            "--gps-out or --imu-out",
            outlets and (outlets.gps_out or outlets.imu_out),
        ),
        (options.now, "--now", "--gps-in", options.gps_in),
        (http, "--http", "--truth-packets or --truth-returns", fine),
    ):
        if given and excluded:
            raise InputError(other, f"found beside {option}", "only one of the two")


@contextmanager
def _on_ports(emulator: "Emulator", options: StreamOptions) -> Iterator["Emulator"]:
    """Yield the emulator with the ports of the options; port 0 gives a reserved free port for each sensor."""
    _, data_port = options.receiver
    ports = {"sensor.data_port": data_port, "sensor.position_port": options.position_port}
    settings: dict[str, object] = {key: port for key, port in ports.items() if port is not None}
    free = [key for key, port in settings.items() if port == 0]
    rig = emulator.scenario.rig
    with FREE_PORTS.load()(len(free) * (1 + len(rig))) if free else nullcontext([]) as found:
        given = iter(found)
        settings |= {key: next(given) for key in free}
        if free and rig:
            own = [{key.removeprefix("sensor."): next(given) for key in free} for _ in rig]
            tables = (unit.model_dump(mode="json", exclude_none=True) for unit in rig)
            settings["rig"] = [table | keys for table, keys in zip(tables, own, strict=True)]
        yield emulator.changed(settings)

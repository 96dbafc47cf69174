"""Streaming of a scene over UDP in real time."""

from collections import Counter
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Sequence
from collections.abc import Set as AbstractSet
from contextlib import ExitStack, closing, contextmanager, nullcontext
from dataclasses import asdict, replace
from threading import Event, Thread
from typing import TYPE_CHECKING, Any

from vlp16emu.doors import door, has_door
from vlp16emu.engine import Engine, Unit
from vlp16emu.engine.engine import sent_before
from vlp16emu.errors import InputError
from vlp16emu.output import write_json
from vlp16emu.run.options import StreamOptions, TruthTo
from vlp16emu.run.report import About, Streamed, UnitSent
from vlp16emu.sinks import (
    LOOK_AHEAD_PACKETS,
    FellBehind,
    Late,
    Pacer,
    PacketSink,
    StreamReport,
    UdpSink,
    stream,
)
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import S_NS, seconds_to_ns

if TYPE_CHECKING:
    from vlp16emu.run.emulator import Emulator


def stream_run(
    emulator: "Emulator",
    options: StreamOptions,
    *,
    watched: Callable[[PacketSink, Pacer], PacketSink] = lambda sink, _: sink,
    opened: Callable[[Sequence[Unit]], None] = lambda _: None,
    look_ahead: int = LOOK_AHEAD_PACKETS,
    preparing: Callable[[float], None] = lambda _: None,
    progress: Callable[[float], None] = lambda _: None,
    notify: Callable[[FellBehind], None] = lambda _: None,
    stop: Event | None = None,
) -> Streamed:
    """Send the packets of a run over UDP, each at its time; raises the errors of `Emulator.stream`.

    Parameters
    ----------
    watched : called with the sink of the packets and their clock; returns the sink that replaces it
    opened : called with the sensors, which have their ports, before the first packet is computed, when the
        sockets are open
    look_ahead : packets of a sensor that are computed before the first one is sent
    preparing : called with the simulated seconds computed so far into `prepare`
    progress : called with the simulated seconds so far, packet by packet
    notify : called each time that the stream falls behind
    stop : ends the stream from another thread
    """
    (host, _) = options.receiver
    truth = TruthTo.of(options.truth)
    pacer = Pacer(options.speed)
    http = options.http
    stop = stop or Event()
    _check(options, truth)
    with ExitStack() as stack:
        enter = stack.enter_context
        on_ports = enter(_on_ports(emulator.with_truth_in(truth), options))  # frames contain the ports
        emulator = on_ports.stopped_by(stop)
        scenario = emulator.scenario
        units = emulator.parts.units
        span_s = scenario.span_s(0.0, options.duration_s)
        is_live = scenario.motion.takes_poses or options.poses is not None
        flight = enter(door("live")(emulator, options.poses)) if is_live else None
        policy = flight.prepare(stop, pacer) if flight else Late(options.late)  # waits for the first pose
        outlets = enter(door("outlets")(options.outlets)) if options.outlets else None
        engine = replace(
            emulator.engine, prompt=http is not None
        )  # settings from there should take effect soon
        feed = enter(closing(PacketFeed(engine, *span_s, also=outlets.kinds if outlets else ())))
        udp = enter(_udp(emulator, options, host, progress))  # a wrong address fails before any casting
        way = outlets.open(udp, scenario.imu) if outlets else udp
        opened(units)
        packets = enter(_packets(emulator, options, feed, span_s, progress=preparing, stop=stop))
        way = watched(way, pacer)
        powered_for_s = units[0].section.powered_for_s or 0.0
        gps_in = options.gps_in and door("gps_in")(options.gps_in, scenario.gps, powered_for_s)
        way = enter(gps_in).sink(way) if gps_in else way  # outermost: watchers see the packets that are sent
        way = flight.begun(way, pacer, now=options.now) if flight else way
        ahead = len(units) * (flight.look_ahead if flight else look_ahead)
        report = stream(
            packets,
            way,
            pacer,
            begun=lambda now: http and enter(door("web")(feed, udp, now, http)),
            late=policy,
            notify=notify,
            go_on_from=None
            if options.prepare
            else flight.going_on(feed.go_on_from)
            if flight
            else feed.go_on_from,
            now=options.now,
            stop=stop,
            look_ahead_packets=ahead + (outlets.look_ahead(scenario.imu) if outlets else 0),
        )
        live = flight.report(report.simulated_s if report.interrupted else span_s[1]) if flight else None
    report = replace(report, skipped=report.skipped + feed.skipped)
    sent = outlets.results(report.skipped) if outlets else (None, None)
    asked = replace(options, to=host, late=policy)
    ran = emulator.with_engine(feed.engine)  # with the settings and events that came during the run
    return _streamed(ran, asked, report, udp, live, gps_in and gps_in.result, *sent)


@contextmanager
def _packets(
    emulator: "Emulator",
    options: StreamOptions,
    feed: "PacketFeed",
    span_s: tuple[float, float],
    **hooks: Any,
) -> Iterator[Iterable[Packet]]:
    """Yield the packets to send: prepared ones, or those of the feed, with the ground truth written beside them."""
    if options.prepare:
        yield door("prepared")(emulator, options, **hooks)
    else:
        with emulator.truth(TruthTo.of(options.truth), span_s, of=feed) as writer:
            yield writer.beside(feed) if writer else feed


def _streamed(
    emulator: "Emulator", options: StreamOptions, report: StreamReport, udp: UdpSink, *more: Any
) -> Streamed:
    """Return the result of a stream, with `more` as its last fields, and write its start time to the ground truth."""
    scenario = emulator.scenario
    speed = options.speed
    if (
        truth := TruthTo.of(options.truth)
    ) and report.first:  # so that live results can be compared with the truth
        times = {"moved_s": report.moved_s, "speed": speed, "packet_0": asdict(report.first)}
        write_json(truth.folder / "time.json", times)
    is_known = report.behind and has_door("keeps_up_with")
    enough = door("keeps_up_with")(report.behind, scenario, speed) if is_known else ()
    units = (
        UnitSent.of(*each, (0.0, report.simulated_s))
        for each in zip(emulator.parts.units, udp.sent, strict=True)
    )
    asked = str(options.to), speed, options.late, tuple(units)
    return Streamed(About.of(emulator.name, scenario), *asked, report, tuple(enough), emulator.finding, *more)


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
            raise InputError(other, f"found beside {option}", "one of both")


@contextmanager
def _on_ports(emulator: "Emulator", options: StreamOptions) -> Iterator["Emulator"]:
    """Yield the emulator with the ports of the options; port 0 gives a reserved free port for each sensor."""
    _, data_port = options.receiver
    ports = {"sensor.data_port": data_port, "sensor.position_port": options.position_port}
    settings: dict[str, object] = {key: port for key, port in ports.items() if port is not None}
    free = [key for key, port in settings.items() if port == 0]
    rig = emulator.scenario.rig
    with door("free_ports")(len(free) * (1 + len(rig))) if free else nullcontext([]) as found:
        given = iter(found)
        settings |= {key: next(given) for key in free}
        if free and rig:
            own = [{key.removeprefix("sensor."): next(given) for key in free} for _ in rig]
            tables = (unit.model_dump(mode="json", exclude_none=True) for unit in rig)
            settings["rig"] = [table | keys for table, keys in zip(tables, own, strict=True)]
        yield emulator.changed(settings)


def _udp(
    emulator: "Emulator", options: StreamOptions, host: str, progress: Callable[[float], None]
) -> UdpSink:
    links = [unit.link for unit in emulator.parts.units]
    start_ns = emulator.scenario.start_ns
    return UdpSink(
        links,
        host,
        as_sensor=options.is_from_sensor,
        interface=options.interface,
        sent=lambda due_ns: progress((due_ns - start_ns) / S_NS),
    )


class PacketFeed:
    """Iterator over the packets of a run in order of sending, which can skip ahead or continue with other events.

    Parameters
    ----------
    engine : engine that makes the packets
    start_s, stop_s : span of the run, since the first pulse
    also : further kinds of packets to send

    Raises InputError if the engine does not have the span, or the scene lacks a device for `also`.
    """

    def __init__(
        self, engine: Engine, start_s: float, stop_s: float, *, also: Collection[PacketKind] = ()
    ) -> None:
        self.engine = engine  # Makes the packets from here on
        self._stop_s = stop_s
        self._beside = door("beside")(engine, also) if also else None
        self._packets = self._from(start_s)
        self._reached_ns = engine.scenario.start_ns
        self._at_reached = set[tuple[int, PacketKind]]()
        self._from_ns: int | None = None
        self.skipped = Counter[PacketKind]()  # Packets that were skipped, by kind

    def __iter__(self) -> Iterator[Packet]:
        return self

    def __next__(self) -> Packet:
        from_ns = self._from_ns
        self._from_ns = None
        if from_ns is not None:
            self._leave_out(from_ns)
        packet = next(self._packets)
        if packet.due_ns > self._reached_ns:
            self._reached_ns = packet.due_ns
            self._at_reached.clear()
        self._at_reached.add((packet.unit, packet.kind))
        return packet

    def close(self) -> None:
        """Stop the workers, and wait for the blocks in progress."""
        self._packets = iter(())

    def go_on_from(self, due_ns: int) -> None:
        """Skip packets due before a UTC time, from the next packet on; callable from any thread."""
        self._from_ns = due_ns

    def begin_again(self, from_ns: int, engine: Engine) -> None:
        """Continue from a UTC time, or from the present packet if that is earlier, with another engine; between packets."""
        before = self._packets
        self.engine = engine
        if isinstance(
            before, Generator
        ):  # its workers end in the background, as the next packet is due at once
            Thread(target=before.close, name="let go", daemon=True).start()
        if from_ns > self._reached_ns:
            from_ns = self._reached_ns
            there = self._at_reached.copy()
        else:
            there = set()
        self._packets = self._after(from_ns, there)

    def _from(self, start_s: float) -> Iterator[Packet]:
        packets = self.engine.packets(start_s, self._stop_s)
        if self._beside is None:
            return packets
        return iter(self._beside.among(packets, seconds_to_ns(start_s), seconds_to_ns(self._stop_s)))

    def _after(self, from_ns: int, there: AbstractSet[tuple[int, PacketKind]]) -> Iterator[Packet]:
        """Yield packets due from a UTC time on, without packets of `there` due at that time, which have been sent."""
        for packet in self._from(self._since_s(from_ns)):
            if packet.due_ns > from_ns or (packet.unit, packet.kind) not in there:
                yield packet

    def _leave_out(self, from_ns: int) -> None:
        """Continue at a UTC time, and count the packets before it as skipped."""
        from_ns = min(from_ns, self.engine.scenario.start_ns + round(self._stop_s * S_NS))
        if from_ns <= self._reached_ns:
            return
        self.close()  # generator of the earlier packets
        self.skipped += self._count(from_ns) - self._count(self._reached_ns + 1)
        self._packets = self._from(self._since_s(from_ns))

    def _count(self, before_ns: int) -> Counter[PacketKind]:
        """Count the packets of all units due before a UTC time, by kind."""
        scenario = self.engine.scenario
        units = self.engine.parts.units
        since_ns = before_ns - scenario.start_ns
        kinds = PacketKind.DATA, PacketKind.POSITION
        sent = {kind: sum(sent_before(scenario, unit, kind, since_ns) for unit in units) for kind in kinds}
        return Counter(sent | (self._beside.count(0, since_ns) if self._beside else {}))

    def _since_s(self, utc_ns: int) -> float:
        return (utc_ns - self.engine.scenario.start_ns) / S_NS

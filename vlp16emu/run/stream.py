"""A scene over UDP in real time."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event
from typing import Any

from vlp16emu.doors import door
from vlp16emu.engine import Unit
from vlp16emu.errors import InputError
from vlp16emu.motion.settings import takes_poses
from vlp16emu.run.feed import PacketFeed
from vlp16emu.run.options import Http, RecordOptions, StreamOptions, TruthTo
from vlp16emu.run.record import prepared, record
from vlp16emu.run.report import About, Streamed, UnitSent, options_for, outlet_result, write_times
from vlp16emu.run.run import Run
from vlp16emu.sinks import (
    LOOK_AHEAD_PACKETS,
    FellBehind,
    Late,
    Outlet,
    Pacer,
    PacketSink,
    RigSink,
    SinkByKind,
    StreamReport,
    UnderWay,
    free_ports,
    stream,
)
from vlp16emu.types import Packet, PacketKind
from vlp16emu.units import S_NS


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamHooks:
    """Functions of a program that are called while its stream runs."""

    watched: Callable[[PacketSink, Pacer], PacketSink] = lambda sink, _: sink
    """Called with the sink of the packets and their clock; returns the sink that takes them instead."""
    opened: Callable[[Sequence[Unit]], None] = lambda _: None
    """Called with the sensors, which have their ports, before the first packet is computed, when the sockets are open."""
    look_ahead: int = LOOK_AHEAD_PACKETS
    """Packets of a sensor that are computed before the first one leaves."""
    preparing: Callable[[float], None] = lambda _: None
    """Called with the simulated seconds computed so far into `prepare`."""
    progress: Callable[[float], None] = lambda _: None
    """Called with the simulated seconds so far, packet by packet."""
    notify: Callable[[FellBehind], None] = lambda _: None
    """Called each time that the stream falls behind."""
    stop: Event | None = None
    """Ends the stream from another thread."""


def stream_run(run: Run, options: StreamOptions, hooks: StreamHooks) -> Streamed:
    """Send the packets of a run over UDP, each at its time; errors as `Emulator.stream`."""
    (host, _), truth = options.receiver, TruthTo.of(options.truth)
    _check(options, truth)
    pacer, policy, stop = Pacer(options.speed), Late(options.late), hooks.stop or Event()
    with ExitStack() as stack:
        run = stack.enter_context(_on_ports(run.with_truth_in(truth), options))
        scenario, parts = run.scenario, run.engine.parts
        span_s = scenario.span_s(0.0, options.duration_s)
        stack.enter_context(run.engine.windows.stopped_by(stop))
        is_live = takes_poses(scenario.motion) or options.poses is not None
        flight = stack.enter_context(door("live")(run, options.poses)) if is_live else None
        policy = flight.prepare(stop, pacer) if flight else policy
        outlets = door("outlets")(options.outlets) if options.outlets else None
        engine = replace(run.engine, prompt=options.http is not None)
        feed = stack.enter_context(closing(PacketFeed(engine, *span_s, also=outlets.kinds if outlets else ())))
        sink = stack.enter_context(_rig(run, options, host, hooks))
        ways = stack.enter_context(outlets.opened(scenario.imu)) if outlets else {}
        hooks.opened(parts.units)
        packets = _packets(run, options, hooks, feed, span_s, stack, stop)
        way = hooks.watched(SinkByKind(sink, ways) if ways else sink, pacer)
        clock = options.gps_in and door("gps_in")(
            options.gps_in, scenario.gps, parts.units[0].section.powered_for_s or 0.0
        )
        way = stack.enter_context(clock).sink(way) if clock else way
        way = flight.begun(way, pacer, now=options.now) if flight else way
        ahead = len(parts.units) * (flight.look_ahead if flight else hooks.look_ahead)
        report = stream(
            packets,
            way,
            pacer,
            begun=lambda under_way: _serve(options.http, feed, sink, under_way, stack),
            late=policy,
            notify=hooks.notify,
            go_on_from=None if options.prepare else _going_on(feed, flight, pacer),
            now=options.now,
            stop=stop,
            look_ahead_packets=ahead + (outlets.look_ahead(scenario.imu) if outlets else 0),
        )
        live = flight.report(report.simulated_s if report.interrupted else span_s[1]) if flight else None
    if truth is not None:
        write_times(truth, report, options.speed)
    report = replace(report, skipped=report.skipped + feed.skipped)
    made = live, clock.result if clock else None
    return _streamed(run, replace(options, to=host, late=policy), report, sink, ways, *made)


@contextmanager
def _on_ports(run: Run, options: StreamOptions) -> Iterator[Run]:
    """Yield the run with the ports of the options; those of 0 are free ones, one for each sensor, which are reserved meanwhile."""
    settings, rig = options.settings, run.scenario.rig
    free = [key for key, port in settings.items() if port == 0]
    with free_ports(len(free) * (1 + len(rig))) as ports:
        given = iter(ports)
        settings |= {key: next(given) for key in free}
        if free and rig:
            own = [{key.removeprefix("sensor."): next(given) for key in free} for _ in rig]
            tables = (unit.model_dump(mode="json", exclude_none=True) for unit in rig)
            settings["rig"] = [table | keys for table, keys in zip(tables, own, strict=True)]
        yield run.with_settings(settings)


def _streamed(
    run: Run,
    options: StreamOptions,
    report: StreamReport,
    sink: RigSink,
    ways: Mapping[PacketKind, Outlet],
    live: Any | None,
    gps_in: Any | None,
) -> Streamed:
    sent = zip(run.engine.parts.units, sink.results, strict=True)
    return Streamed(
        about=About.of(run.name, run.scenario),
        to=str(options.to),
        speed=options.speed,
        late=options.late,
        units=tuple(UnitSent.of(unit, n.data_packets, n.position_packets, report.simulated_s) for unit, n in sent),
        sent=report,
        keeps_up_with=tuple(options_for(report.behind, run.scenario, options.speed)),
        audit=run.finding,
        live=live,
        gps_in=gps_in,
        gps_out=outlet_result(PacketKind.NMEA, ways, report.skipped),
        imu_out=outlet_result(PacketKind.IMU, ways, report.skipped),
    )


def _rig(run: Run, options: StreamOptions, host: str, hooks: StreamHooks) -> RigSink:
    """Return the sockets of all sensors."""
    start_ns = run.scenario.start_ns
    return RigSink(
        [unit.link for unit in run.engine.parts.units],
        host,
        as_sensor=options.is_from_sensor,
        interface=options.interface,
        sent=lambda due_ns: hooks.progress((due_ns - start_ns) / S_NS),
    )


def _check(options: StreamOptions, truth: TruthTo | None) -> None:
    """Refuse options that exclude each other."""
    beside = options.outlets and (options.outlets.gps_out or options.outlets.imu_out)
    _exclude(options.prepare, "--prepare", {"--http": options.http, "--gps-out or --imu-out": beside})
    _exclude(options.now, "--now", {"--gps-in": options.gps_in})
    fine = truth and (truth.per_packet or truth.per_return)
    _exclude(options.http, "--http", {"--truth-packets or --truth-returns": fine})


def _exclude(given: object, option: str, others: Mapping[str, object]) -> None:
    for other, value in others.items():
        if given and value:
            raise InputError(other, f"found beside {option}", "one of both")


def _packets(
    run: Run,
    options: StreamOptions,
    hooks: StreamHooks,
    feed: PacketFeed,
    span_s: tuple[float, float],
    stack: ExitStack,
    stop: Event,
) -> Iterable[Packet]:
    """Return the packets to send: those of the feed, or those of a capture that is recorded first."""
    if options.prepare is None:
        truth = stack.enter_context(run.truth(options.truth, span_s, of=feed))
        return truth.beside(feed) if truth else feed
    asked = RecordOptions(duration_s=options.duration_s, truth=options.truth)
    return prepared(
        [unit.link for unit in run.engine.parts.units],
        Path(options.prepare),
        lambda path: record(run, path, asked, as_due=True, progress=hooks.preparing, stop=stop),
    )


def _going_on(feed: PacketFeed, flight: Any | None, pacer: Pacer) -> Callable[[int], None]:
    """Return the function that makes the feed skip packets due before a UTC time."""
    further: Callable[[int], None] = flight.going_on(feed.go_on_from, pacer) if flight else feed.go_on_from
    return further


def _serve(http: Http | None, feed: PacketFeed, sink: RigSink, now: UnderWay, until: ExitStack) -> None:
    """Serve the web interfaces of the sensors until the stream ends."""
    if http is not None:
        until.enter_context(door("web")(feed, sink, now, http))

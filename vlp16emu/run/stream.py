"""A scene over UDP in real time."""

from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event
from typing import Any

from vlp16emu.doors import door
from vlp16emu.errors import InputError
from vlp16emu.motion.live_settings import takes_poses
from vlp16emu.run.feed import PacketFeed
from vlp16emu.run.options import ClockInput, Http, Outlets, PosesIn, TruthTo
from vlp16emu.run.record import prepared, record
from vlp16emu.run.report import Streamed, summed_up, with_outlets, write_times
from vlp16emu.run.run import Run, TruthPlace
from vlp16emu.sinks import (
    LOOK_AHEAD_PACKETS,
    LOOPBACK,
    FellBehind,
    Late,
    Pacer,
    PacketSink,
    RigSink,
    SinkByKind,
    UnderWay,
    stream,
)
from vlp16emu.types import Packet
from vlp16emu.units import S_NS


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamOptions:
    """How a run is streamed."""

    to: str = LOOPBACK
    """Receiver; may be a broadcast address."""
    duration_s: float | None = None
    """Until the end of the scene if None."""
    truth: TruthPlace | None = None
    """Folder for the ground truth of the run, as of `Emulator.record`."""
    speed: float = 1.0
    """Simulated seconds per second."""
    late: Late | str = Late.PACE
    """`pace` keeps the spacing of packets that are late by more than 50 ms, and the delay; `skip` drops them."""
    as_sensor: bool = False
    """Send from the sensor's address, which this machine must have, with its headers."""
    interface: str | None = None
    """Network interface, for instance `eth0`; None for the one that the system's routes give."""
    now: bool = False
    """Move stamps and sentences by whole seconds into the present; truth stays at the time of the scene."""
    prepare: str | Path | None = None
    """Capture that the whole run is computed into before the first packet leaves, and which stays."""
    http: Http | None = None
    """Where the web interfaces of the sensors are, through which the stream is set; None for none."""
    poses: PosesIn | None = None
    """Where those of a live scene come in; its stream begins with the first one, and drops what is late."""
    outlets: Outlets | None = None
    """What leaves beside the packets of the sensors: sentences and pulses of the receiver, inertial samples."""
    gps_in: ClockInput | None = None
    """A real receiver, which sets the clock of the sensors instead of that of the scene."""
    watched: Callable[[PacketSink, Pacer], PacketSink] = lambda sink, _: sink
    """Called with the sink of the packets and their clock; returns the sink that takes them instead."""
    opened: Callable[[], None] = lambda: None
    """Called once before the first packet is computed, when the sockets are open."""
    preparing: Callable[[float], None] = lambda _: None
    """Called with the simulated seconds computed so far into `prepare`."""
    progress: Callable[[float], None] = lambda _: None
    """Called with the simulated seconds so far, packet by packet."""
    notify: Callable[[FellBehind], None] = lambda _: None
    """Called each time that the stream falls behind."""
    stop: Event | None = None
    """Ends the stream from another thread."""


def stream_run(run: Run, options: StreamOptions) -> Streamed:
    """Send the packets of a run over UDP, each at its time; errors as of `Emulator.stream`."""
    _check(options)
    run, stop = run.with_truth_in(options.truth), options.stop or Event()
    pacer, policy = Pacer(options.speed), Late(options.late)
    scenario, units = run.scenario, len(run.engine.parts.units)
    span_s, outlets = scenario.span_s(0.0, options.duration_s), options.outlets
    with ExitStack() as stack:
        stack.enter_context(run.engine.windows.stopped_by(stop))
        flight = stack.enter_context(door("live")(run, options.poses)) if _is_live(run, options) else None
        policy = flight.prepare(stop, pacer) if flight else policy
        engine = replace(run.engine, prompt=options.http is not None)
        feed = stack.enter_context(closing(PacketFeed(engine, *span_s, also=outlets.kinds if outlets else ())))
        sink = stack.enter_context(_rig(run, options))
        ways = stack.enter_context(outlets.opened(scenario.imu)) if outlets else {}
        options.opened()
        packets = _packets(run, options, feed, span_s, stack, stop)
        way = options.watched(SinkByKind(sink, ways) if ways else sink, pacer)
        clock = options.gps_in
        reader = stack.enter_context(clock.reader(scenario.gps, scenario.sensor.powered_for_s)) if clock else None
        way = reader.sink(way) if reader else way
        way = flight.begun(way, pacer, now=options.now) if flight else way
        ahead = units * (flight.look_ahead if flight else LOOK_AHEAD_PACKETS)
        report = stream(
            packets,
            way,
            pacer,
            begun=lambda under_way: _serve(options.http, feed, sink, under_way, stack),
            late=policy,
            notify=options.notify,
            go_on_from=None if options.prepare else _going_on(feed, flight, pacer),
            now=options.now,
            stop=stop,
            look_ahead_packets=ahead + (outlets.look_ahead(scenario.imu) if outlets else 0),
        )
        live = flight.report(report.simulated_s if report.interrupted else span_s[1]) if flight else None
    if options.truth is not None:
        write_times(options.truth, report, options.speed)
    how = run.name, options.to, options.speed, policy
    heard = reader.result if reader else None
    streamed = summed_up(feed, report, sink.results, *how, audit=run.finding, live=live, gps_in=heard)
    return with_outlets(streamed, ways, report.skipped + feed.skipped)


def _rig(run: Run, options: StreamOptions) -> RigSink:
    """Return the sockets of all sensors."""
    start_ns = run.scenario.start_ns
    return RigSink(
        [unit.link for unit in run.engine.parts.units],
        options.to,
        as_sensor=options.as_sensor,
        interface=options.interface,
        sent=lambda due_ns: options.progress((due_ns - start_ns) / S_NS),
    )


def _check(options: StreamOptions) -> None:
    """Refuse options that exclude each other."""
    truth, http = options.truth, options.http
    fine = isinstance(truth, TruthTo) and (truth.per_packet or truth.per_return)
    of_prepare = {"--http": http, "--gps-out or --imu-out": options.outlets and options.outlets.kinds}
    _exclude(options.prepare is not None, "--prepare", of_prepare)
    _exclude(options.now, "--now", {"--gps-in": options.gps_in})
    _exclude(http is not None, "--http", {"--truth-packets or --truth-returns": fine})


def _exclude(given: bool, option: str, others: Mapping[str, object]) -> None:
    for other, value in others.items():
        if given and value:
            raise InputError(other, f"found beside {option}", "one of both")


def _is_live(run: Run, options: StreamOptions) -> bool:
    return takes_poses(run.scenario.motion) or options.poses is not None


def _packets(
    run: Run, options: StreamOptions, feed: PacketFeed, span_s: tuple[float, float], stack: ExitStack, stop: Event
) -> Iterable[Packet]:
    """Return the packets to send: those of the feed, or those of a capture that is recorded first."""
    if options.prepare is None:
        truth = stack.enter_context(run.truth(options.truth, span_s, of=feed))
        return truth.beside(feed) if truth else feed
    links = [unit.link for unit in run.engine.parts.units]
    return prepared(
        links,
        Path(options.prepare),
        lambda path: record(
            run,
            path,
            duration_s=options.duration_s,
            truth=options.truth,
            as_due=True,
            progress=options.preparing,
            stop=stop,
        ),
    )


def _going_on(feed: PacketFeed, flight: Any | None, pacer: Pacer) -> Callable[[int], None]:
    """Return what lets the feed go on further ahead."""
    further: Callable[[int], None] = flight.going_on(feed.go_on_from, pacer) if flight else feed.go_on_from
    return further


def _serve(http: Http | None, feed: PacketFeed, sink: RigSink, now: UnderWay, until: ExitStack) -> None:
    """Serve the web interfaces of the sensors until the stream ends."""
    if http is not None:
        until.enter_context(door("web")(feed, sink, now, http))

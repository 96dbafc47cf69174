"""A scene over UDP in real time."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Event

from vlp16emu.errors import InputError, TrajectoryError
from vlp16emu.flight import Flight, PosesIn, flying
from vlp16emu.motion.live import LiveMotion
from vlp16emu.recording import prepared
from vlp16emu.run import Run
from vlp16emu.sinks import (
    LOOK_AHEAD_PACKETS,
    LOOPBACK,
    FellBehind,
    GpsIn,
    GpsInSink,
    GpsReader,
    Late,
    Outlets,
    Pacer,
    PacketSink,
    RigSink,
    SinkByKind,
    TruthTo,
    UnderWay,
    stream,
)
from vlp16emu.streaming import Engine, Http, Streamed, summed_up, with_outlets, write_times
from vlp16emu.units import S_NS

_NONE = Outlets()


def _report(progress: Callable[[float], None], start_ns: int, due_ns: int) -> None:
    progress((due_ns - start_ns) / S_NS)


def _exclude(given: bool, option: str, others: Mapping[str, object]) -> None:  # the value of an option
    for other, value in others.items():
        if given and value:
            raise InputError(other, f"found beside {option}", "one of both")


def _going_on(engine: Engine, flight: Flight | None, pacer: Pacer) -> Callable[[int], None]:
    return flight.going_on(engine.go_on_from, pacer) if flight else engine.go_on_from


class Streams(Run):
    """A run whose packets are sent; parameters and errors as of `Emulator`."""

    def stream(
        self,
        *,
        to: str = LOOPBACK,
        duration_s: float | None = None,
        truth: str | Path | TruthTo | None = None,
        speed: float = 1.0,
        late: Late | str = Late.PACE,
        as_sensor: bool = False,
        interface: str | None = None,
        now: bool = False,
        prepare: str | Path | None = None,
        http: Http | None = None,
        poses: PosesIn | None = None,
        outlets: Outlets = _NONE,
        gps_in: GpsIn | None = None,
        watched: Callable[[PacketSink, Pacer], PacketSink] = lambda sink, _: sink,
        opened: Callable[[], None] = lambda: None,
        preparing: Callable[[float], None] = lambda _: None,
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
        interface : by which all leaves, for instance `eth0`; None for that which the system's routes give
        now : move stamps and sentences by whole seconds into the present; truth stays at the time of the scene
        prepare : capture that the whole run is computed into before the first packet leaves, and which stays
        http : where the web interfaces of the sensors are, through which the stream is set; None for none
        poses : where those of a live scene come in; its stream begins with the first one, and drops what is late
        outlets : what leaves beside the packets of the sensors: sentences and pulses of the receiver, inertial samples
        gps_in : a real receiver, which sets the clock of the sensors instead of that of the scene
        watched : called with the sink of the packets and their clock; gives the sink that takes them instead
        opened : called once before the first packet is computed, when the sockets are open
        preparing : called with the simulated seconds computed so far into `prepare`
        progress : called with the simulated seconds so far, packet by packet
        notify : called each time that the stream falls behind
        stop : ends the stream from another thread

        Raises
        ------
        OutputError
            where the receiver is unknown or out of reach, or the sensor's address is not this machine's
        InputError
            where arguments exclude each other, or poses are for a scene that is not live
        ScenarioError
            where the sensor has no packets
        TrajectoryError
            where the walk is over before the span
        RunError
            where the system cannot send any more
        """
        fine = isinstance(truth, TruthTo) and (truth.per_packet or truth.per_return)
        _exclude(prepare is not None, "--prepare", {"--http": http, "--gps-out or --imu-out": outlets.kinds})
        _exclude(now, "--now", {"--gps-in": gps_in})
        _exclude(http is not None, "--http", {"--truth-packets or --truth-returns": fine})
        stop, pacer, policy = stop or Event(), Pacer(speed), Late(late)
        span_s, links = self.scenario.span_s(0.0, duration_s), [unit.link for unit in self.parts.units]
        with ExitStack() as stack:
            stack.enter_context(self.windows.stopped_by(stop))
            flight = stack.enter_context(flying(self, poses, self._files))
            policy = flight.prepare(stop, pacer) if flight else policy
            self.prompt = http is not None
            engine = stack.enter_context(closing(Engine(self, *span_s, also=outlets.kinds)))
            sent = partial(_report, progress, self.scenario.start_ns)
            rig = RigSink(links, to, as_sensor=as_sensor, interface=interface, sent=sent)
            sink = stack.enter_context(rig)
            ways = stack.enter_context(outlets.opened(self.scenario.imu))
            opened()
            if prepare is None:
                packets = stack.enter_context(self._with_truth(engine, span_s, truth))
            else:
                run = partial(self.record, as_due=True, progress=preparing, stop=stop)
                packets = prepared(links, Path(prepare), partial(run, duration_s=duration_s, truth=truth))
            reader = stack.enter_context(self._listening(gps_in)) if gps_in else None
            way: PacketSink = watched(SinkByKind(sink, ways) if ways else sink, pacer)
            way = GpsInSink(way, reader.line) if reader else way
            report = stream(
                packets,
                flight.begun(way, pacer, now=now) if flight else way,
                pacer,
                begun=lambda under_way: self._serve(http, engine, sink, under_way, stack) if http else None,
                late=policy,
                notify=notify,
                go_on_from=None if prepare else _going_on(engine, flight, pacer),
                now=now,
                stop=stop,
                look_ahead_packets=(flight.look_ahead if flight else LOOK_AHEAD_PACKETS) * len(links)
                + outlets.look_ahead(self.scenario.imu),
            )
            live = flight.report(report.simulated_s if report.interrupted else span_s[1]) if flight else None
        if truth is not None:
            write_times(truth, report, speed)
        found, how = self.audit.finding if self.audit else None, (self.name, to, speed, policy)
        streamed = summed_up(self, engine, report, sink.results, *how, audit=found, live=live)
        streamed = replace(streamed, gps_in=reader.result if reader else None)
        return with_outlets(streamed, ways, report.skipped + engine.skipped)

    def put_pose(
        self, position_m: Sequence[float], quaternion: Sequence[float], t_ns: int | None = None
    ) -> bool:
        """Bring a pose into a live scene, from any thread; parameters, result and errors as of `PoseInput.put`.

        Raises
        ------
        TrajectoryError
            where the scene is not live
        """
        if not isinstance(carrier := self.parts.carrier, LiveMotion):
            raise TrajectoryError("motion.kind", f'found "{self.scenario.motion.kind}"', '"live"')
        return carrier.poses.put(position_m, quaternion, t_ns)

    def _listening(self, gps_in: GpsIn) -> GpsReader:
        return GpsReader(gps_in, self.scenario.gps, self.scenario.sensor.powered_for_s)

    def _serve(self, http: Http, engine: Engine, sink: RigSink, now: UnderWay, until: ExitStack) -> None:
        from vlp16emu.control import Control, web_interfaces  # here: few streams have them

        until.enter_context(web_interfaces(Control(self, engine, sink, now), http))

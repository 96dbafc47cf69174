"""Control of a running stream by the web interfaces.

Settings become events of the scene a moment later, and the stream follows.
"""

import math
import socket
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from functools import partial
from ipaddress import ip_address
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from vlp16emu.engine import Unit
from vlp16emu.errors import InputError, OutputError
from vlp16emu.explain import explain
from vlp16emu.extras.bench.device import Device, DeviceInfo, DeviceSettings, DeviceStatus, check_saved
from vlp16emu.extras.bench.events import Event, checked, event, tables
from vlp16emu.extras.bench.web import WebServer
from vlp16emu.hosts import bound, place_of
from vlp16emu.packets import POSITION_BYTES, decode_position
from vlp16emu.run.feed import PacketFeed
from vlp16emu.run.part import WebPart
from vlp16emu.run.scene_stream import SceneStream
from vlp16emu.run.stream import Stream
from vlp16emu.scenario import Scenario
from vlp16emu.sensor.settings import SensorSettings, require_packets
from vlp16emu.sinks import UdpSink
from vlp16emu.trees import Tree
from vlp16emu.types import PpsState, SensorModel
from vlp16emu.units import FOREVER_NS, S_NS, seconds_to_ns

_LEAD_NS = 150_000_000
"""Least time from a setting to the first packet with it: by then the engine has computed that packet
again."""
_MOST_LEAD_NS = 1_000_000_000
_MERGED_S = 5.0  # greatest time that a setting waits until the packets of earlier settings are computed ahead
_CALM_S = 2.0
_PROMPT = 2
"""Number of changes, without a pause of this length between them, for which packets are computed again; later
changes take effect after the packets that are already computed."""
_APART_S = 1.0
_APART = 20.0
"""Least time between such later changes, and the least ratio to the time that a change took: each makes the
next one slower."""
_POLL_S = 0.01
_WARM_S = 0.01
_STEP_S = 0.001  # times of events are rounded up to this


class WebInterfaces(WebPart):
    """Web interface of each sensor of a stream.

    Parameters
    ----------
    stream : stream of a scene, with options for the interfaces

    Raises OutputError if it cannot listen on an address, before a world is grown.
    """

    def __init__(self, stream: SceneStream) -> None:
        self._stream = stream
        saved = stream.options.http.saved if stream.options.http else None
        if saved is not None:
            check_saved(saved)
        self.places: list[
            tuple[str, int]
        ] = []  # host and port of each; none before the first packet is ready
        self._control: Control | None = None
        self._listeners: list[socket.socket] = []
        http = stream.options.http
        assert http is not None
        host, first = http.address
        with ExitStack() as opening:
            for number in range(len(stream.links)):
                port = first and first + number
                listener = bound(socket.SOCK_STREAM, host, port, f"--http {place_of(host, port)}")
                self._listeners.append(opening.enter_context(listener))
            self._open = opening.pop_all()

    def ready(self) -> None:
        """Serve the interfaces; raises the errors of `Device`."""
        stream = self._stream
        http = stream.options.http
        assert http is not None
        control = Control(stream.feed, stream.udp, stream, http.saved)
        for number, (device, listener) in enumerate(zip(control.devices, self._listeners, strict=True)):
            fault = partial(control.fault, number)
            server = WebServer(device, listener, fault=fault, delay_s=partial(control.delay_s, number))
            self._open.enter_context(server)
            self.places.append(server.address)
        self._open.enter_context(control.following())
        self._control = control

    def end(self, _error: BaseException | None) -> None:
        """Stop the servers."""
        self._open.close()

    def happen(self, kind: str, unit: int = 1, **keys: object) -> int:
        """Add an event of a unit, as `Control.happen` does, once the first packet is ready."""
        assert self._control is not None
        return self._control.happen(kind, unit, **keys)


def _settings_of(unit: Unit, host: str) -> DeviceSettings:
    sensor = require_packets(unit.section)
    places = {key: getattr(sensor, key) for key in ("data_port", "position_port", "address")}
    return DeviceSettings(host=host, **places).after(asdict(SensorSettings.of(sensor)))


class Control:
    """Control of a stream by settings from other threads, with reports of the state of its sensors.

    After a pause, a setting makes the engine compute packets again from a moment ahead; so does the next
    setting, when these packets are ready. In a flood, all settings of a second are one change, which takes
    effect after the packets that are already computed. So no client can block the engine.

    Parameters
    ----------
    feed : source of the packets
    sink : sender of the packets
    under_way : the stream before its first packet
    saved : file of the first sensor's saved settings; other sensors use its name with their number
    """

    def __init__(self, feed: PacketFeed, sink: UdpSink, under_way: Stream, saved: Path | None) -> None:
        self._feed = feed
        self._sink = sink
        self._under_way = under_way
        self._factory = [_settings_of(unit, sink.address) for unit in feed.engine.parts.units]
        self._events: list[Event] = list(feed.engine.scenario.events)
        self._to_come = sorted(self._events, key=lambda event: event.at_s)
        """Events of the scene that the web interface does not show yet."""
        self._set = list[Event]()
        self._wanted = list[Event]()
        """Settings of the web interface, and other events, of the next change; `at_s` counts from that
        change."""
        self._at_ns = 0  # UTC, ns, of the first packet with the latest change
        self._lock = threading.Lock()
        self._asked = threading.Event()
        self._over = threading.Event()
        self._taking_up = threading.Lock()
        self._lead_ns = _LEAD_NS
        self._ahead_ns = 0
        self._calm_s = 0.0
        self._prompt = _PROMPT
        self.devices = [self._device(unit, saved) for unit in feed.engine.parts.units]
        """State of the web interface of each sensor."""

    def _device(self, unit: Unit, saved: Path | None) -> Device:
        sensor = require_packets(unit.section)
        n = unit.number
        return Device(
            self._factory[n],
            status=partial(self.status, n),
            is_up=lambda: not self._feed.engine.parts.units[n].state.silences.at(self._since_ns()),
            changed=partial(self._changed, n),
            info=DeviceInfo(sensor.serial_number, SensorModel(sensor.model), unit.link.source_mac),
            saved=saved.with_stem(f"{saved.stem}_{n + 1}") if saved and n else saved,
        )

    @contextmanager
    def following(self) -> Iterator[None]:
        """Make the stream follow settings; saved settings hold from the first packet on."""
        for number, device in enumerate(self.devices):
            self._redirect(number, self._factory[number], device.settings)
            self._follow(number, self._factory[number], device.settings)
        if self._apply_pending() is None:  # loads the modules, so that the first change is as quick as others
            engine = self._feed.engine.with_events([event("setting", 0.0, rpm=600)])
            if not self._scenario.motion.takes_poses:
                deque(engine.packets(0.0, _WARM_S), 0)
        thread = threading.Thread(target=self._run, name="settings", daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._over.set()
            self._asked.set()
            thread.join()

    def happen(self, kind: str, unit: int = 1, **keys: object) -> int:
        """Add an event of a unit, from 1, a moment from now, and return its UTC in ns; from any thread.

        Raises InputError if there is no such event, or this scene cannot have it.
        """
        table: Tree = {"kind": kind, "at_s": 0.0, "unit": unit, **keys}
        scene = {key: getattr(self._scenario, key) for key in ("sensor", "rig", "gps")}
        try:
            wanted = checked([table], scene)
        except ValidationError as error:
            where, found, expected = explain(error, tables().json_schema())
            raise InputError(f"event {kind}{where.removeprefix('[0]')}", found, expected) from None
        except ValueError as error:
            raise InputError(
                f"event {kind}", f"found unit {unit} of {self._scenario.title}", str(error)
            ) from None
        with self._lock:
            self._wanted += wanted
        self._apply_pending()
        return self._at_ns

    def fault(self, unit: int) -> int | None:
        """Return the HTTP status of all answers of a unit now, 0 for no answer; None without a fault."""
        return next((error.status or 0 for error in self._web_events(unit, "http_error")), None)

    def delay_s(self, unit: int) -> float:
        """Return the time from a request to its answer now, in seconds; 0 if no event delays it."""
        return next((event.by_s for event in self._web_events(unit, "http_delay")), 0.0)

    def _web_events(self, unit: int, kind: str) -> Iterator[Event]:
        since_ns = self._since_ns()
        for change in self._events:
            if (change.kind, change.unit) == (kind, unit + 1) and change.begin_ns <= since_ns < change.end_ns:
                yield change

    def status(self, unit: int) -> DeviceStatus:
        """Return the state of a unit."""
        self._adopt()
        of = self._feed.engine.parts.units[unit]
        since_ns = self._since_ns()
        now_ns = self._scenario.start_ns + since_ns
        off = of.state.silences.before(since_ns)
        power_up_ns = off[1] if off else -seconds_to_ns(of.section.powered_for_s or 0.0)
        settings = self.devices[unit].settings
        rpm = of.head.rotor.rpm_at(since_ns)
        second_ns = max(now_ns // S_NS * S_NS - self._scenario.start_ns, 0)
        payload = self._sink.latest_position[unit]
        sent = (
            decode_position(payload) if len(payload) == POSITION_BYTES else None
        )  # an event may truncate a packet
        return DeviceStatus(
            t_ns=now_ns,
            pps=sent.pps if sent else PpsState.ABSENT,
            position=_position_text(sent.sentence) if sent else "",
            motor_rpm=rpm,
            motor_on=rpm > 0,
            phase_locked=settings.phase_lock_deg != "off" and self._scenario.gps.connected,
            phase_cdeg=round(100 * float(of.head.rotor.angle_deg(np.array([second_ns]))[0])) % 36_000,
            laser_on=settings.laser,
            powered_for_s=(since_ns - power_up_ns) / S_NS,
        )

    @property
    def _scenario(self) -> Scenario:
        return self._feed.engine.scenario

    def _since_ns(self, ahead_ns: int = 0) -> int:
        """Return the due time since the first pulse of the packet that leaves now, or `ahead_ns` later."""
        return self._under_way.due_in_ns(ahead_ns) - self._scenario.start_ns

    def _changed(self, unit: int, old: DeviceSettings, new: DeviceSettings, *, restarts: bool) -> None:
        """Apply new settings of a unit with the next change of the stream.

        Raises OutputError if the new receiver is out of reach, or no longer on this machine on which the
        stream began.
        """
        with self._lock:
            self._redirect(unit, old, new)
            if restarts:  # earlier settings are lost
                others = [one for one in self._set if one.unit != unit + 1]
                self._set = [*others, event("power_cycle", 0.0, unit + 1)]
            self._follow(unit, self._factory[unit] if restarts else old, new)
        self._asked.set()

    def _follow(self, unit: int, old: DeviceSettings, new: DeviceSettings) -> None:
        """Add the new settings to the next change as one event, after a restart if there is one."""
        keys = new.changes_from(old)
        if not self._scenario.gps.connected:
            keys.pop("phase_lock_deg", None)
        own = [one for one in self._set if one.unit == unit + 1]
        if keys and own and own[-1].kind == "setting":
            self._set[self._set.index(own[-1])] = own[-1].model_copy(update=keys)
        elif keys:
            self._set.append(event("setting", own[-1].off_s if own else 0.0, unit + 1, **keys))

    def _adopt(self) -> None:
        """Update the web interface with the settings of past events."""
        since_s = self._since_ns() / S_NS
        due = list[Event]()
        with self._lock:
            while self._to_come and self._to_come[0].at_s <= since_s:
                due.append(self._to_come.pop(0))
        for one in due:  # without the lock, which a device that is being set may wait for
            self.devices[one.unit - 1].adopt(partial(self._after, one))

    def _after(self, one: Event, settings: DeviceSettings) -> DeviceSettings:
        if one.effect == "power":
            return self._factory[one.unit - 1]
        return settings.after(one.settings) if one.effect == "settings" else settings

    def _redirect(self, unit: int, old: DeviceSettings, new: DeviceSettings) -> None:
        """Send to the new receiver; to another machine only if the run began with another machine."""
        where = [(each.host, each.data_port, each.position_port) for each in (old, new)]
        if where[0] == where[1]:
            return
        if ip_address(self._factory[unit].host).is_loopback and not ip_address(new.host).is_loopback:
            expected = "an address of this machine, 127.0.0.0/8, unless the stream begins with another --to"
            raise OutputError("host.addr", new.host, expected)
        self._sink.redirect(unit, *where[1])

    def _run(self) -> None:
        while self._asked.wait() and not self._over.is_set():
            self._asked.clear()
            begin_s = time.monotonic()
            if (from_ns := self._apply_pending()) is not None:
                next_s = begin_s + max(_APART_S, _APART * (time.monotonic() - begin_s))
                self._wait_until_ahead(from_ns)
                self._over.wait(0.0 if self._prompt else max(next_s - time.monotonic(), 0.0))

    def _apply_pending(self) -> int | None:
        """Compute packets again from a moment ahead, if there are new settings, and return its UTC."""
        with self._taking_up:
            until_ns = self._under_way.made_until_ns
            self._prompt = _PROMPT if time.monotonic() >= self._calm_s else self._prompt
            self._ahead_ns = max(self._ahead_ns, until_ns - self._under_way.due_in_ns(0))
            from_ns = self._since_ns(self._lead_ns)
            if not self._prompt and until_ns < FOREVER_NS:  # some packets are not yet computed
                from_ns = max(from_ns, until_ns - self._scenario.start_ns)
            at_s = round(math.ceil(from_ns / S_NS / _STEP_S) * _STEP_S, 3)
            with self._lock:
                made, happening = (
                    [one.model_copy(update={"at_s": at_s + one.at_s}) for one in some]
                    for some in (self._set, self._wanted)
                )
                self._set = []
                self._wanted = []
                self._to_come = sorted([*self._to_come, *happening], key=lambda event: event.at_s)
                self._events = self._events + made + happening
            if not made and not happening:
                return None
            self._calm_s = time.monotonic() + _CALM_S
            self._prompt = max(self._prompt - 1, 0)
            self._at_ns = self._scenario.start_ns + seconds_to_ns(at_s)
            engine = self._feed.engine.with_events(self._events)
            due_ns = self._scenario.start_ns + from_ns
            self._under_way.redo(due_ns, lambda from_ns: self._feed.begin_again(from_ns, engine))
            return due_ns

    def _wait_until_ahead(self, from_ns: int) -> None:
        """Wait until packets of a change are computed ahead.

        If that took longer than their lead, the next lead is longer.
        """
        begin_s = time.monotonic()
        has_begun = False
        while (took_s := time.monotonic() - begin_s) < _MERGED_S and not self._over.wait(_POLL_S):
            until_ns = self._under_way.made_until_ns
            if not has_begun and until_ns > from_ns:
                has_begun = True
                self._lead_ns = min(max(_LEAD_NS, round(2 * took_s * S_NS)), _MOST_LEAD_NS)
            # A live run is never computed far ahead.
            if has_begun and until_ns >= self._under_way.due_in_ns(min(self._lead_ns, self._ahead_ns // 2)):
                return


def _position_text(sentence: bytes) -> str:
    """Return the position of the receiver in the format of the sensor: `49 00.00N 200 .00W`."""
    import pynmea2  # here: a sensor without a receiver does not need it

    try:
        fix = pynmea2.parse(sentence.decode("ascii"), check=True)
    except ValueError:
        return ""
    if not isinstance(fix, pynmea2.RMC) or not fix.is_valid:
        return ""
    parts = []
    for angle_deg, letter in ((fix.latitude, fix.lat_dir), (fix.longitude, fix.lon_dir)):
        minutes = round(abs(angle_deg) * 60, 2)
        parts.append(f"{int(minutes // 60):02d} {minutes % 60:05.2f}{letter}")
    return " ".join(parts)

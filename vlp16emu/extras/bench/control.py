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
from vlp16emu.extras.bench.events import Event, check_events, event_adapter, make_event
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
_MERGE_WAIT_S = 5.0
"""Greatest time that a setting waits until the packets of earlier settings are computed ahead."""
_CALM_S = 2.0  # length of a pause between changes after which packets are computed again
_PROMPT_CHANGES = 2
"""Number of changes without such a pause for which packets are computed again; later changes take effect
after the packets that are already computed."""
_FLOOD_INTERVAL_S = 1.0  # least time between such later changes
_FLOOD_FACTOR = 20.0
"""Least ratio of that time to the time that a change took: each makes the next one slower."""
_POLL_S = 0.01
_WARM_UP_S = 0.01  # span of the first packets that are computed with an event
_STEP_S = 0.001  # times of events are rounded up to this


class WebInterfaces(WebPart):
    """Web interface of each sensor of a stream.

    Parameters
    ----------
    stream : stream of a scene, with options for the interfaces

    Raises OutputError if it cannot listen on an address, before a world is grown.
    """

    def __init__(self, stream: SceneStream) -> None:
        http = stream.options.http
        assert http is not None
        if http.saved is not None:
            check_saved(http.saved)
        self._stream = stream
        self._saved = http.saved
        self.places: list[tuple[str, int]] = []
        """Host and port of each interface; none before the first packet is ready."""
        self._control: Control | None = None
        self._listeners: list[socket.socket] = []
        host, first_port = http.address
        with ExitStack() as stack:
            for number in range(len(stream.links)):
                port = first_port and first_port + number
                listener = bound(socket.SOCK_STREAM, host, port, f"--http {place_of(host, port)}")
                self._listeners.append(stack.enter_context(listener))
            self._open = stack.pop_all()

    def ready(self) -> None:
        """Serve the interfaces; raises the errors of `Device`."""
        stream = self._stream
        control = Control(stream.feed, stream.udp, stream, self._saved)
        for number, (device, listener) in enumerate(zip(control.devices, self._listeners, strict=True)):
            fault = partial(control.fault, number)
            server = WebServer(device, listener, fault=fault, delay_s=partial(control.delay_s, number))
            self._open.enter_context(server)
            self.places.append(server.address)
        self._open.enter_context(control.follow_settings())
        self._control = control

    def end(self, _error: BaseException | None) -> None:
        """Stop the servers."""
        self._open.close()

    def happen(self, kind: str, unit: int = 1, **keys: object) -> int:
        """Add an event of a unit, as `Control.happen` does, once the first packet is ready."""
        assert self._control is not None
        return self._control.happen(kind, unit, **keys)


def _settings_of(unit: Unit, host: str) -> DeviceSettings:
    """Return the settings of a unit in the scene, with the host that it sends to."""
    sensor = require_packets(unit.section)
    settings = DeviceSettings(
        host=host, data_port=sensor.data_port, position_port=sensor.position_port, address=sensor.address
    )
    return settings.after(asdict(SensorSettings.of(sensor)))


class Control:
    """Control of a stream by settings from other threads, with reports of the state of its sensors.

    After a pause, a setting makes the engine compute packets again from a moment ahead; so does the next
    setting, when these packets are ready. In a flood, all settings of a second are one change, which takes
    effect after the packets that are already computed. So no client can block the engine.

    Parameters
    ----------
    feed : source of the packets
    sink : sender of the packets
    stream : the stream before its first packet
    saved : file of the first sensor's saved settings; other sensors use its name with their number
    """

    def __init__(self, feed: PacketFeed, sink: UdpSink, stream: Stream, saved: Path | None) -> None:
        self._feed = feed
        self._sink = sink
        self._stream = stream
        self._factory = [_settings_of(unit, sink.address) for unit in feed.engine.parts.units]
        self._events: list[Event] = list(feed.engine.scenario.events)
        self._future_events = sorted(self._events, key=lambda event: event.at_s)
        """Events that the web interface does not show yet."""
        self._new_settings = list[Event]()
        self._new_events = list[Event]()
        """Settings of the web interface, and other events, of the next change; `at_s` counts from that
        change."""
        self._at_ns = 0  # UTC, ns, of the first packet with the latest change
        self._lock = threading.Lock()
        self._has_changes = threading.Event()
        self._over = threading.Event()
        self._apply_lock = threading.Lock()
        self._lead_ns = _LEAD_NS
        self._ahead_ns = 0
        self._calm_from_s = 0.0
        self._prompt_left = _PROMPT_CHANGES
        self.devices = [self._device(unit, saved) for unit in feed.engine.parts.units]
        """State of the web interface of each sensor."""

    def _device(self, unit: Unit, saved: Path | None) -> Device:
        sensor = require_packets(unit.section)
        number = unit.number
        return Device(
            self._factory[number],
            status=partial(self.status, number),
            is_up=lambda: not self._feed.engine.parts.units[number].state.silences.at(self._since_ns()),
            on_change=partial(self._queue_settings, number),
            info=DeviceInfo(sensor.serial_number, SensorModel(sensor.model), unit.link.source_mac),
            saved=saved.with_stem(f"{saved.stem}_{number + 1}") if saved and number else saved,
        )

    @contextmanager
    def follow_settings(self) -> Iterator[None]:
        """Make the stream follow settings; saved settings hold from the first packet on."""
        for number, device in enumerate(self.devices):
            self._redirect(number, self._factory[number], device.settings)
            self._queue_event(number, self._factory[number], device.settings)
        if self._apply_pending() is None:  # loads the modules, so that the first change is as quick as others
            engine = self._feed.engine.with_events([make_event("setting", 0.0, rpm=600)])
            if not self._scenario.motion.takes_poses:
                deque(engine.packets(0.0, _WARM_UP_S), 0)
        thread = threading.Thread(target=self._run, name="settings", daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._over.set()
            self._has_changes.set()
            thread.join()

    def happen(self, kind: str, unit: int = 1, **keys: object) -> int:
        """Add an event of a unit, from 1, a moment from now, and return its UTC in ns; from any thread.

        Raises InputError if there is no such event, or this scene cannot have it.
        """
        table: Tree = {"kind": kind, "at_s": 0.0, "unit": unit, **keys}
        scene = {key: getattr(self._scenario, key) for key in ("sensor", "rig", "gps")}
        try:
            events = check_events([table], scene)
        except ValidationError as error:
            where, found, expected = explain(error, event_adapter().json_schema())
            raise InputError(f"event {kind}{where.removeprefix('[0]')}", found, expected) from None
        except ValueError as error:
            found = f"found unit {unit} of {self._scenario.title}"
            raise InputError(f"event {kind}", found, str(error)) from None
        with self._lock:
            self._new_events += events
        self._apply_pending()
        return self._at_ns

    def fault(self, unit: int) -> int | None:
        """Return the HTTP status of all answers of a unit now, 0 for no answer; None without a fault."""
        return next((event.status or 0 for event in self._web_events(unit, "http_error")), None)

    def delay_s(self, unit: int) -> float:
        """Return the time from a request to its answer now, in seconds; 0 if no event delays it."""
        return next((event.by_s for event in self._web_events(unit, "http_delay")), 0.0)

    def _web_events(self, unit: int, kind: str) -> Iterator[Event]:
        """Yield the events of a kind and a unit that hold now."""
        since_ns = self._since_ns()
        for event in self._events:
            is_such = (event.kind, event.unit) == (kind, unit + 1)
            if is_such and event.begin_ns <= since_ns < event.end_ns:
                yield event

    def status(self, unit: int) -> DeviceStatus:
        """Return the state of a unit."""
        self._adopt()
        sensor = self._feed.engine.parts.units[unit]
        since_ns = self._since_ns()
        now_ns = self._scenario.start_ns + since_ns
        silence = sensor.state.silences.before(since_ns)
        power_up_ns = silence[1] if silence else -seconds_to_ns(sensor.section.powered_for_s or 0.0)
        settings = self.devices[unit].settings
        rpm = sensor.head.rotor.rpm_at(since_ns)
        second_ns = max(now_ns // S_NS * S_NS - self._scenario.start_ns, 0)
        payload = self._sink.latest_position[unit]
        position = None
        if len(payload) == POSITION_BYTES:  # an event may truncate a packet
            position = decode_position(payload)
        return DeviceStatus(
            t_ns=now_ns,
            pps=position.pps if position else PpsState.ABSENT,
            position=_position_text(position.sentence) if position else "",
            motor_rpm=rpm,
            motor_on=rpm > 0,
            phase_locked=settings.is_locked and self._scenario.gps.connected,
            phase_cdeg=round(100 * float(sensor.head.rotor.angle_deg(np.array([second_ns]))[0])) % 36_000,
            laser_on=settings.laser,
            powered_for_s=(since_ns - power_up_ns) / S_NS,
        )

    @property
    def _scenario(self) -> Scenario:
        return self._feed.engine.scenario

    def _since_ns(self, ahead_ns: int = 0) -> int:
        """Return the due time since the first pulse of the packet that leaves now, or `ahead_ns` later."""
        return self._stream.due_in_ns(ahead_ns) - self._scenario.start_ns

    def _queue_settings(self, unit: int, old: DeviceSettings, new: DeviceSettings, *, restarts: bool) -> None:
        """Apply new settings of a unit with the next change of the stream.

        Raises OutputError if the new receiver is out of reach, or no longer on this machine on which the
        stream began.
        """
        with self._lock:
            self._redirect(unit, old, new)
            if restarts:  # earlier settings are lost
                of_others = [event for event in self._new_settings if event.unit != unit + 1]
                self._new_settings = [*of_others, make_event("power_cycle", 0.0, unit + 1)]
            self._queue_event(unit, self._factory[unit] if restarts else old, new)
        self._has_changes.set()

    def _queue_event(self, unit: int, old: DeviceSettings, new: DeviceSettings) -> None:
        """Add the new settings to the next change as one event, after a restart if there is one."""
        keys = new.changes_from(old)
        if not self._scenario.gps.connected:
            keys.pop("phase_lock_deg", None)
        if not keys:
            return
        last = next((event for event in reversed(self._new_settings) if event.unit == unit + 1), None)
        if last is None:
            self._new_settings.append(make_event("setting", 0.0, unit + 1, **keys))
        elif last.kind == "setting":
            self._new_settings[self._new_settings.index(last)] = last.model_copy(update=keys)
        else:
            self._new_settings.append(make_event("setting", last.off_s, unit + 1, **keys))

    def _adopt(self) -> None:
        """Update the web interface with the settings of past events."""
        since_s = self._since_ns() / S_NS
        events = list[Event]()
        with self._lock:
            while self._future_events and self._future_events[0].at_s <= since_s:
                events.append(self._future_events.pop(0))
        for event in events:  # without the lock, which a device that is being set may wait for
            self.devices[event.unit - 1].adopt(partial(self._settings_after, event))

    def _settings_after(self, event: Event, settings: DeviceSettings) -> DeviceSettings:
        """Return the settings of a unit after an event."""
        if event.effect == "power":
            return self._factory[event.unit - 1]
        return settings.after(event.settings) if event.effect == "settings" else settings

    def _redirect(self, unit: int, old: DeviceSettings, new: DeviceSettings) -> None:
        """Send to the new receiver; to another machine only if the run began with another machine."""
        receiver = (new.host, new.data_port, new.position_port)
        if receiver == (old.host, old.data_port, old.position_port):
            return
        if ip_address(self._factory[unit].host).is_loopback and not ip_address(new.host).is_loopback:
            expected = "an address of this machine, 127.0.0.0/8, unless the stream begins with another --to"
            raise OutputError("host.addr", new.host, expected)
        self._sink.redirect(unit, *receiver)

    def _run(self) -> None:
        while self._has_changes.wait() and not self._over.is_set():
            self._has_changes.clear()
            begin_s = time.monotonic()
            if (from_ns := self._apply_pending()) is not None:
                next_s = begin_s + max(_FLOOD_INTERVAL_S, _FLOOD_FACTOR * (time.monotonic() - begin_s))
                self._wait_until_ahead(from_ns)
                self._over.wait(0.0 if self._prompt_left else max(next_s - time.monotonic(), 0.0))

    def _apply_pending(self) -> int | None:
        """Compute packets again from a moment ahead, if there are new settings, and return its UTC."""
        with self._apply_lock:
            until_ns = self._stream.made_until_ns
            self._prompt_left = (
                _PROMPT_CHANGES if time.monotonic() >= self._calm_from_s else self._prompt_left
            )
            self._ahead_ns = max(self._ahead_ns, until_ns - self._stream.due_in_ns(0))
            from_ns = self._since_ns(self._lead_ns)
            if not self._prompt_left and until_ns < FOREVER_NS:  # some packets are not yet computed
                from_ns = max(from_ns, until_ns - self._scenario.start_ns)
            at_s = round(math.ceil(from_ns / S_NS / _STEP_S) * _STEP_S, 3)
            with self._lock:
                settings = _delay_events(self._new_settings, at_s)
                events = _delay_events(self._new_events, at_s)
                self._new_settings = []
                self._new_events = []
                self._future_events = sorted([*self._future_events, *events], key=lambda event: event.at_s)
                self._events = self._events + settings + events
            if not settings and not events:
                return None
            self._calm_from_s = time.monotonic() + _CALM_S
            self._prompt_left = max(self._prompt_left - 1, 0)
            self._at_ns = self._scenario.start_ns + seconds_to_ns(at_s)
            engine = self._feed.engine.with_events(self._events)
            due_ns = self._scenario.start_ns + from_ns
            self._stream.redo(due_ns, lambda from_ns: self._feed.begin_again(from_ns, engine))
            return due_ns

    def _wait_until_ahead(self, from_ns: int) -> None:
        """Wait until packets of a change are computed ahead.

        If that took longer than their lead, the next lead is longer.
        """
        begin_s = time.monotonic()
        has_begun = False
        while (took_s := time.monotonic() - begin_s) < _MERGE_WAIT_S and not self._over.wait(_POLL_S):
            until_ns = self._stream.made_until_ns
            if not has_begun and until_ns > from_ns:
                has_begun = True
                self._lead_ns = min(max(_LEAD_NS, round(2 * took_s * S_NS)), _MOST_LEAD_NS)
            # A live run is never computed far ahead.
            if has_begun and until_ns >= self._stream.due_in_ns(min(self._lead_ns, self._ahead_ns // 2)):
                return


def _delay_events(events: list[Event], by_s: float) -> list[Event]:
    return [event.model_copy(update={"at_s": by_s + event.at_s}) for event in events]


def _position_text(sentence: bytes) -> str:
    """Return the position of the receiver as the sensor shows it, such as `49 00.60N 08 24.25E`."""
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

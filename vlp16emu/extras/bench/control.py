"""The web interfaces of a run's sensors: what is set there becomes an event of the scene, a moment from now, and the stream follows."""

import math
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from ipaddress import ip_address
from pathlib import Path
from typing import Any

import numpy as np

from vlp16emu.engine import Unit
from vlp16emu.errors import OutputError, PacketError, Vlp16emuError
from vlp16emu.extras.bench.state import Device, DeviceInfo, DeviceSettings, DeviceStatus
from vlp16emu.extras.bench.web import HttpFault, WebServer
from vlp16emu.packets import POSITION_BYTES, decode_position, parse_rmc
from vlp16emu.run.feed import PacketFeed
from vlp16emu.run.options import Http
from vlp16emu.scenario import Scenario
from vlp16emu.scenario.events import Event, HttpError, PowerCycle, Setting
from vlp16emu.sensor.settings import on_the_wire
from vlp16emu.sinks import RigSink, UnderWay
from vlp16emu.types import PpsState, ReturnMode, SensorModel
from vlp16emu.units import S_NS, seconds_to_ns

_LEAD_NS = 150_000_000
"""From a setting to the first packet that follows it: by then the engine has made that packet anew."""
_STEP_S = 0.001
"""Times of events are rounded up to that."""


@contextmanager
def web_interfaces(feed: PacketFeed, sink: RigSink, under_way: UnderWay, http: Http) -> Iterator[None]:
    """Serve the web interface of each sensor; errors as of `WebServer` and `Device`."""
    control = Control(feed, sink, under_way)
    with ExitStack() as stack:
        servers = []
        host, first = http.address
        for number, device in enumerate(control.devices(http.saved)):
            control.change(number, device.settings)  # what was saved, it has from its first moment on
            port, fault = first + number if first else 0, partial(control.fault, number)
            servers.append(WebServer(device, host, port, fault=fault))
            stack.enter_context(servers[-1])
        http.serving([server.address for server in servers])
        yield


def _settings_of(unit: Unit, host: str) -> DeviceSettings:
    """Give what the scene sets on a sensor."""
    sensor = on_the_wire(unit.section)
    return DeviceSettings(
        rpm=sensor.rpm,
        return_mode=ReturnMode(sensor.return_mode),
        phase_lock_on=sensor.phase_lock_deg is not None,
        phase_lock_cdeg=round(100 * (sensor.phase_lock_deg or 0.0)) % 36_000,
        host=host,
        data_port=sensor.data_port,
        position_port=sensor.position_port,
        address=sensor.address,
    )


class Control:
    """Makes a stream follow settings that come from other threads, and reports the state of its sensors.

    Parameters
    ----------
    feed : makes the packets
    sink : sends them
    under_way : the stream, which is about to send its first packet
    """

    def __init__(self, feed: PacketFeed, sink: RigSink, under_way: UnderWay) -> None:
        self._feed, self._sink = feed, sink
        self._under_way = under_way
        self._factory = [_settings_of(unit, sink.address) for unit in feed.engine.parts.units]
        self._settings = list(self._factory)
        self._lock = threading.Lock()
        self._events: list[Event] = list(feed.engine.scenario.events)
        self._to_come = sorted(self._events, key=lambda event: event.at_s)
        """Events of the scene that the web interface does not show yet."""
        self._devices = list[Device]()

    def devices(self, saved: Path | None) -> Iterator[Device]:
        """Make what the web interface of each sensor shows and sets; a file keeps the saved settings of the first."""
        for unit, factory in zip(self._feed.engine.parts.units, self._factory, strict=True):
            sensor, n = on_the_wire(unit.section), unit.number
            device = Device(
                factory,
                status=partial(self.status, n),
                changed=partial(self.change, n),
                reset=partial(self.reset, n),
                info=DeviceInfo(sensor.serial_number, SensorModel(sensor.model), unit.link.source_mac),
                saved=saved.with_stem(f"{saved.stem}_{n + 1}") if saved and n else saved,
            )
            self._devices.append(device)
            yield device

    def fault(self, unit: int) -> HttpFault | None:
        """Find what is wrong with the web interface of a unit now."""
        since_s = self._since_ns() / S_NS
        errors = (event for event in self._scenario.events if isinstance(event, HttpError))
        here = (error for error in errors if error.unit == unit + 1 and error.lasts_at(since_s))
        return next((HttpFault(error.status) for error in here), None)

    def change(self, unit: int, new: DeviceSettings) -> None:
        """Set a unit anew; its packets follow within 0.2 s.

        Raises
        ------
        OutputError
            where the new receiver is out of reach, or another machine, though the stream began on this one; then nothing changes
        """
        with self._lock:
            old, self._settings[unit] = self._settings[unit], new
            try:
                self._redirect(unit, old, new)
            except Vlp16emuError:
                self._settings[unit] = old
                raise
            if keys := self._changed(old, new):
                self._happen(lambda at_s: [Setting(kind="setting", at_s=at_s, unit=unit + 1, **keys)])

    def reset(self, unit: int, power_up: DeviceSettings) -> None:
        """Let a unit start again, with the settings that it has saved."""
        with self._lock:
            self._redirect(unit, self._settings[unit], power_up)
            self._settings[unit] = power_up
            keys = self._changed(self._factory[unit], power_up)

            def events(at_s: float) -> list[Event]:
                """Power is lost; settings that are not those of the scene follow."""
                lost = PowerCycle(kind="power_cycle", at_s=at_s, unit=unit + 1)
                again_s = at_s + lost.off_s
                saved = [Setting(kind="setting", at_s=again_s, unit=unit + 1, **keys)] if keys else []
                return [lost, *saved]

            self._happen(events)

    def status(self, unit: int) -> DeviceStatus:
        """Report the state of a unit."""
        self._adopt()
        of, since_ns = self._feed.engine.parts.units[unit], self._since_ns()
        now_ns = self._scenario.start_ns + since_ns
        ends_ns = [end for _, end in of.timeline.silences_ns if end <= since_ns]
        powered_ns = since_ns - max(ends_ns) if ends_ns else since_ns + seconds_to_ns(of.section.powered_for_s)
        settings, rpm = self._settings[unit], of.head.rotor.rpm_at(since_ns)
        second_ns = max(now_ns // S_NS * S_NS - self._scenario.start_ns, 0)
        payload = self._sink.latest_position(unit)
        sent = decode_position(payload) if len(payload) == POSITION_BYTES else None  # none is cut by an event
        return DeviceStatus(
            t_ns=now_ns,
            pps=sent.pps if sent else PpsState.ABSENT,
            position=_place(sent.sentence) if sent else "",
            motor_rpm=rpm,
            motor_on=rpm > 0,
            phase_locked=settings.phase_lock_on and self._scenario.gps.connected,
            phase_cdeg=round(100 * float(of.head.rotor.angle_deg(np.array([second_ns]))[0])) % 36_000,
            laser_on=settings.laser_on,
            powered_for_s=powered_ns / S_NS,
            is_up=not of.timeline.is_silent(since_ns),
        )

    @property
    def _scenario(self) -> Scenario:
        return self._feed.engine.scenario

    def _since_ns(self, ahead_ns: int = 0) -> int:
        """Time since the first pulse at which the packet is due that leaves now, or later."""
        return self._under_way.due_in_ns(ahead_ns) - self._scenario.start_ns

    def _adopt(self) -> None:
        """Show what events of the scene have set by now."""
        since_s = self._since_ns() / S_NS
        due = list[tuple[Device, DeviceSettings]]()
        with self._lock:
            while self._to_come and self._to_come[0].at_s <= since_s:
                event = self._to_come.pop(0)
                n = event.unit - 1
                settings = self._settings[n]
                if isinstance(event, PowerCycle):
                    settings = self._factory[n]
                elif isinstance(event, Setting):
                    settings = _with(settings, event)
                self._settings[n] = settings
                due.append((self._devices[n], settings))
        for device, settings in due:  # without the lock: a device that is being set waits for it
            device.adopt(settings)

    def _redirect(self, unit: int, old: DeviceSettings, new: DeviceSettings) -> None:
        """Send to the receiver that is set; to another machine only where the run was begun to send to one."""
        where = [(each.host, each.data_port, each.position_port) for each in (old, new)]
        if where[0] == where[1]:
            return
        if ip_address(self._factory[unit].host).is_loopback and not ip_address(new.host).is_loopback:
            expected = "an address of this machine, 127.0.0.0/8, unless the stream begins with another --to"
            raise OutputError("host.addr", new.host, expected)
        self._sink.redirect(unit, *where[1])

    def _changed(self, old: DeviceSettings, new: DeviceSettings) -> dict[str, Any]:
        """Keys of a setting that takes the one to the other."""
        before, after = _keys_of(old), _keys_of(new)
        if not self._scenario.gps.connected:
            del after["phase_lock_deg"]
        return {key: value for key, value in after.items() if value != before[key]}

    def _happen(self, events: Callable[[float], list[Event]]) -> None:
        """Add events a moment from now, and have what is due from then on made anew; holds the lock."""
        start_ns, from_ns = self._scenario.start_ns, self._since_ns(_LEAD_NS)
        at_s = math.ceil(from_ns / S_NS / _STEP_S) * _STEP_S
        self._events = [*self._events, *events(round(at_s, 3))]
        made = self._events
        self._under_way.redo(start_ns + from_ns, lambda due_ns: self._feed.begin_again(due_ns, made))


def _keys_of(settings: DeviceSettings) -> dict[str, Any]:
    """Keys of an event that sets all of it."""
    return {
        "rpm": settings.rpm,
        "return_mode": str(settings.return_mode),
        "laser": settings.laser_on,
        "fov_deg": settings.fov_deg,
        "phase_lock_deg": settings.phase_lock_cdeg / 100 if settings.phase_lock_on else "off",
    }


def _with(settings: DeviceSettings, event: Setting) -> DeviceSettings:
    phase = event.phase_lock_deg
    keys: dict[str, Any] = {
        "rpm": event.rpm,
        "return_mode": event.return_mode and ReturnMode(event.return_mode),
        "laser_on": event.laser,
        "fov_deg": event.fov_deg,
        "phase_lock_on": None if phase is None else phase != "off",
        "phase_lock_cdeg": round(100 * phase) % 36_000 if isinstance(phase, float) else None,
    }
    return replace(settings, **{key: value for key, value in keys.items() if value is not None})


def _place(sentence: bytes) -> str:
    """Write where the receiver is, as the sensor does: `49 00.00N 200 .00W`."""
    try:
        fix = parse_rmc(sentence)
    except PacketError:
        return ""
    if not fix.valid:
        return ""
    parts = []
    for angle_deg, letters in ((fix.latitude_deg, "NS"), (fix.longitude_deg, "EW")):
        minutes = round(abs(angle_deg) * 60, 2)
        parts.append(f"{int(minutes // 60):02d} {minutes % 60:05.2f}{letters[angle_deg < 0]}")
    return " ".join(parts)

"""The JSON documents of the web interface, and the forms that are sent to it (63-9243 Rev D, section 10.2).

A real unit answers some bad requests with 200 and ignores them. Here every value that the sensor does not take, and every
unknown key, is ignored with the whole request, and the answer says why.
"""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import parse_qsl

from pydantic import ValidationError

from vlp16emu.extras.bench.diagnostics import diagnostics
from vlp16emu.extras.bench.state import Device, DeviceInfo, DeviceSettings, DeviceStatus, explained
from vlp16emu.types import ReturnMode, SensorModel

_MODELS = {SensorModel.VLP_16: "VLP-16", SensorModel.PUCK_LITE: "Puck LITE", SensorModel.PUCK_HI_RES: "Puck Hi-Res"}
"""The first is on record; the others are named as their data sheets do (assumption)."""
_FIRMWARE = Path(__file__).with_name("firmware.json")
"""Images 3.0.41.1, and 1.9.3.0 to fall back on, and their states: invented, and of one piece."""
_PARTS = {
    "/cgi/settings.json": "config",
    "/cgi/diag.json": "diag",
    "/cgi/status.json": "status",
    "/cgi/info.json": "info",
}
"""What is read alone, and its name in the snapshot of all."""
_MOST_KEYS = 16


class FormError(ValueError):
    """A form that changes nothing, with the reason."""


def _whole(text: str) -> int:
    if not re.fullmatch(r"[0-9]{1,5}", text, re.ASCII):
        raise ValueError("a whole number")
    return int(text)


def _is_on(text: str) -> bool:
    if text not in ("on", "off"):
        raise ValueError("on or off")
    return text == "on"


def _return_mode(text: str) -> ReturnMode:
    modes = {mode.capitalize(): mode for mode in ReturnMode}
    if text not in modes:
        raise ValueError(" or ".join(modes))
    return modes[text]


def _switch(on: bool) -> str:
    return "On" if on else "Off"


class _Key(NamedTuple):
    """A setting of the web interface."""

    form: str  # last part of the path that it is sent to, and the table that shows it; empty for the outermost
    name: str
    field: str  # of `DeviceSettings`
    read: Callable[[str], object] = _whole
    shown: Callable[[Any], object] = str
    end: int | None = None  # which end of the field of view it is


_KEYS = (
    _Key("", "rpm", "rpm", shown=int),
    _Key("", "returns", "return_mode", _return_mode, str.capitalize),
    _Key("", "laser", "laser_on", _is_on, _switch),
    _Key("fov", "start", "fov_deg", shown=int, end=0),
    _Key("fov", "end", "fov_deg", shown=int, end=1),
    _Key("host", "addr", "host", str),
    _Key("host", "dport", "data_port"),
    _Key("host", "tport", "position_port"),
    _Key("net", "addr", "address", str),
    _Key("net", "mask", "mask", str),
    _Key("net", "gateway", "gateway", str),
    _Key("net", "dhcp", "dhcp", _is_on, _switch),
    _Key("phaselock", "enabled", "phase_lock_on", _is_on, _switch),
    _Key("phaselock", "offset", "phase_lock_cdeg"),
)
_FORMS = {f"/cgi/setting/{key.form}".rstrip("/"): key.form for key in _KEYS}
_ACTIONS: Mapping[str, tuple[bytes, Callable[[Device], None]]] = {
    "/cgi/save": (b"submit", Device.save),
    "/cgi/reset": (b"reset_system", Device.restart),
}
PATHS = frozenset((*_FORMS, *_ACTIONS))
"""Paths that take forms."""


def document(path: str, device: Device) -> object | None:
    """Return the document of a path, as it is now; None if there is none."""
    if path not in (*_PARTS, "/cgi/snapshot.hdl"):
        return None
    status = device.status()
    snapshot = {
        "config": _settings(device.settings),
        "diag": diagnostics(status),
        "status": _status(status),
        "info": _info(device.info),
    }
    return snapshot[_PARTS[path]] if path in _PARTS else snapshot


def submit(path: str, body: bytes, device: Device) -> None:
    """Do what a form of one of `PATHS` asks for, or nothing of it.

    Raises `FormError` if it has a key or a value that the sensor does not take; others as of `Device`.
    """
    if path in _ACTIONS:
        word, act = _ACTIONS[path]
        if body not in (word, b"data=" + word):
            raise FormError(f"body: found {_quoted(body)}, expected {word.decode()}")
        act(device)
        return
    try:
        pairs = parse_qsl(body.decode("ascii"), keep_blank_values=True, strict_parsing=True, max_num_fields=_MOST_KEYS)
    except ValueError:
        pairs = []
    if not pairs:
        raise FormError(f"body: found {_quoted(body)}, expected key=value")

    def made(settings: DeviceSettings) -> DeviceSettings:
        for name, text in pairs:
            settings = _with(settings, _FORMS[path], name, text)
        return settings

    device.change(made)


def _with(settings: DeviceSettings, form: str, name: str, text: str) -> DeviceSettings:
    keys = {key.name: key for key in _KEYS if key.form == form}
    if name not in keys:
        raise FormError(f"{name[:40]!r}: unknown key, expected {' or '.join(keys)}")
    key = keys[name]
    try:
        value = key.read(text)
        if key.end is not None:
            value = (value, settings.fov_deg[1]) if key.end == 0 else (settings.fov_deg[0], value)
        return replace(settings, **{key.field: value})  # type: ignore[arg-type]  # checked by the class
    except ValidationError as error:
        _, found, expected = explained(error)
        raise FormError(f"{name}: {found}, expected {expected}") from None
    except ValueError as error:
        raise FormError(f"{name}: found {text[:40]!r}, expected {error}") from None


def _quoted(body: bytes) -> str:
    return repr(body[:40].decode("ascii", "replace"))


def _settings(settings: DeviceSettings) -> dict[str, Any]:
    """Write what is set, with the types that units send: numbers of ports and of the phase are texts."""
    tree = dict[str, Any]()
    for key in _KEYS:
        value = getattr(settings, key.field)
        table = tree.setdefault(key.form, {}) if key.form else tree
        table[key.name] = key.shown(value if key.end is None else value[key.end])
    return tree


def _status(status: DeviceStatus) -> dict[str, object]:
    disabled = status.disabled
    return {
        "gps": {"pps_state": status.pps.name.capitalize(), "position": status.position},
        "motor": {
            "state": "Disabled" if disabled else _switch(status.motor_on),
            "rpm": 0 if disabled else round(status.motor_rpm),
            "lock": _switch(status.phase_locked and not disabled),
            "phase": status.phase_cdeg,
        },
        "laser": {"state": "Disabled" if disabled else _switch(status.laser_on)},
    }


def _info(info: DeviceInfo) -> dict[str, object]:
    own = {"model": _MODELS[info.model], "serial": info.serial, "mac_addr": info.mac.hex("-")}
    firmware: dict[str, object] = json.loads(_FIRMWARE.read_text(encoding="utf-8"))
    return own | firmware

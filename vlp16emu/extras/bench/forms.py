"""What is sent to the web interface: forms with settings, save and reset (63-9243 Rev D, section 10.2.3).

A real unit answers some bad requests with 200 and ignores them. Here every value that the sensor does not take, and every
unknown key, is ignored with the whole request, and the answer says why.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any
from urllib.parse import parse_qsl

from pydantic import ValidationError

from vlp16emu.extras.bench.state import Device, DeviceSettings, explained
from vlp16emu.types import ReturnMode

_MOST_KEYS = 16

_Change = Callable[[DeviceSettings, str], dict[str, Any]]


class FormError(ValueError):
    """A form that changes nothing, with the reason."""


def submit(path: str, body: bytes, device: Device) -> None:
    """Do what a form of one of `PATHS` asks for, or nothing of it.

    Raises `FormError` if it has a key or a value that the sensor does not take; others as of `Device`.
    """
    if path in _ACTIONS:
        word, act = _ACTIONS[path]
        if body not in (word, b"data=" + word):
            raise FormError(f"body: found {_shown(body)}, expected {word.decode()}")
        act(device)
        return
    pairs = _pairs(body)

    def made(settings: DeviceSettings) -> DeviceSettings:
        for key, text in pairs:
            settings = _with(settings, _FORMS[path], key, text)
        return settings

    device.change(made)


def _pairs(body: bytes) -> list[tuple[str, str]]:
    """Split a form into keys and values."""
    try:
        pairs = parse_qsl(body.decode("ascii"), keep_blank_values=True, strict_parsing=True, max_num_fields=_MOST_KEYS)
    except ValueError:
        pairs = []
    if not pairs:
        raise FormError(f"body: found {_shown(body)}, expected key=value")
    return pairs


def _with(settings: DeviceSettings, form: Mapping[str, _Change], key: str, text: str) -> DeviceSettings:
    if key not in form:
        raise FormError(f"{key[:40]!r}: unknown key, expected {' or '.join(form)}")
    try:
        return replace(settings, **form[key](settings, text))
    except ValidationError as error:
        _, found, expected = explained(error)
        raise FormError(f"{key}: {found}, expected {expected}") from None
    except ValueError as error:
        raise FormError(f"{key}: found {text[:40]!r}, expected {error}") from None


def _shown(body: bytes) -> str:
    return repr(body[:40].decode("ascii", "replace"))


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


def _setting(field: str, read: Callable[[str], object]) -> _Change:
    return lambda _, text: {field: read(text)}


_FORMS: Mapping[str, Mapping[str, _Change]] = {
    "/cgi/setting": {
        "rpm": _setting("rpm", _whole),
        "returns": _setting("return_mode", _return_mode),
        "laser": _setting("laser_on", _is_on),
    },
    "/cgi/setting/fov": {
        "start": lambda settings, text: {"fov_deg": (_whole(text), settings.fov_deg[1])},
        "end": lambda settings, text: {"fov_deg": (settings.fov_deg[0], _whole(text))},
    },
    "/cgi/setting/host": {
        "addr": _setting("host", str),
        "dport": _setting("data_port", _whole),
        "tport": _setting("position_port", _whole),
    },
    "/cgi/setting/net": {
        "addr": _setting("address", str),
        "mask": _setting("mask", str),
        "gateway": _setting("gateway", str),
        "dhcp": _setting("dhcp", _is_on),
    },
    "/cgi/setting/phaselock": {
        "enabled": _setting("phase_lock_on", _is_on),
        "offset": _setting("phase_lock_cdeg", _whole),
    },
}
_ACTIONS: Mapping[str, tuple[bytes, Callable[[Device], None]]] = {
    "/cgi/save": (b"submit", Device.save),
    "/cgi/reset": (b"reset_system", Device.restart),
}

PATHS = frozenset((*_FORMS, *_ACTIONS))
"""Paths that take forms."""

"""The state behind the web interface: settings, status, and their documents and forms (63-9243 Rev D, 10.2).

A real unit answers some bad requests with 200 and ignores them. Here a request with an invalid value or an
unknown key is ignored as a whole, and the answer gives the reason.
"""

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from ipaddress import IPv4Address
from pathlib import Path
from threading import Lock
from typing import Annotated, Any, NamedTuple, Self
from urllib.parse import parse_qsl

from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass as checked_dataclass

from vlp16emu.errors import InputError, OutputError, Vlp16emuError
from vlp16emu.explain import explain
from vlp16emu.inputs import parse_json, read_text
from vlp16emu.output import OutputFile
from vlp16emu.sensor.beams import MODELS
from vlp16emu.sensor.settings import Address, Port, SensorSettings
from vlp16emu.trees import Table, Tree
from vlp16emu.types import PpsState, ReturnMode, SensorModel
from vlp16emu.units import S_NS

_ALL_ONES = 0xFFFF_FFFF
_MOST_BYTES = 10_000  # limit of saved settings, which have some 400 bytes


def _address(expected: str, is_good: Callable[[IPv4Address], bool]) -> AfterValidator:
    """Return the validator of the text of an address; ValueError with `expected` for a bad one."""

    def read(text: str) -> str:
        try:
            address = IPv4Address(text)
        except ValueError:
            raise ValueError(expected) from None
        if not is_good(address):
            raise ValueError(expected)
        return str(address)

    return AfterValidator(read)


_Receiver = _address(
    "the IPv4 address of a host, or 255.255.255.255",
    lambda at: not (at.is_unspecified or at.is_multicast or (at.is_reserved and int(at) != _ALL_ONES)),
)
_Gateway = _address(
    "the IPv4 address of a router, or 0.0.0.0", lambda at: not (at.is_multicast or at.is_reserved)
)
_Mask = _address(
    "a network mask such as 255.255.255.0", lambda mask: int(mask) > 0 and "01" not in f"{int(mask):032b}"
)


@checked_dataclass(frozen=True, config=ConfigDict(strict=True, extra="forbid"))
class DeviceSettings(SensorSettings):
    """Settings of the web interface, with the factory's defaults (63-9243 Rev D, section 10.2).

    Raises pydantic.ValidationError if the sensor does not accept a value; also from `dataclasses.replace`.
    """

    phase_lock_cdeg: Annotated[int, Field(ge=0, le=35_999)] = 0
    """Rotor angle at each pulse, in 0.01 degree, also while the phase lock is off."""
    host: Annotated[str, _Receiver] = "255.255.255.255"  # IPv4 address that packets are sent to
    data_port: Port = 2368  # destination port of data packets
    position_port: Port = 8308  # destination port of position packets
    address: Address = "192.168.1.201"  # IPv4 address of the sensor
    mask: Annotated[str, _Mask] = "255.255.255.0"  # of its network
    gateway: Annotated[str, _Gateway] = "192.168.1.1"  # of its network
    dhcp: bool = False  # True if a server gives the addresses

    def after(self, changes: Table) -> Self:
        """Return the settings after changes of fields of `SensorSettings`.

        A phase lock that is switched off keeps its angle.
        """
        phase_deg = changes.get("phase_lock_deg", "off")
        if phase_deg == "off":
            return replace(self, **changes)
        return replace(self, **changes, phase_lock_cdeg=round(100 * phase_deg) % 36_000)


_SETTINGS: TypeAdapter[DeviceSettings] = TypeAdapter(DeviceSettings)


class DeviceInfo(NamedTuple):
    """Constants of a unit: names, versions, serial number."""

    serial: str  # digits, as on the label
    model: SensorModel
    mac: bytes  # 6 bytes


@dataclass(frozen=True, slots=True)
class DeviceStatus:
    """State of the sensor at an instant."""

    t_ns: int  # UTC of the emulated instant
    pps: PpsState
    position: str  # as the sensor shows it, such as `49 00.60N 08 24.25E`; empty without a fix
    motor_rpm: float
    motor_on: bool
    phase_locked: bool
    phase_cdeg: int  # rotor angle at the latest pulse, in 0.01 degree
    laser_on: bool
    powered_for_s: float  # since power-up: boards warm up


class Device:
    """The settings of one sensor, safe to read and change from several threads.

    Parameters
    ----------
    factory : settings if none have been saved
    status : returns the present state of the sensor; called from the thread of the web server, and must not
        wait
    is_up : returns True if the sensor answers, which it does not while it starts
    on_change : called at each change as `on_change(before, after, restarts=False)`, with `restarts` if the
        sensor starts again; must not wait; if it raises, nothing changes
    info : constants of the unit
    saved : file that keeps saved settings from run to run; None to keep them for this run only

    Raises InputError if the file has no saved settings.
    """

    def __init__(
        self,
        factory: DeviceSettings,
        *,
        status: Callable[[], DeviceStatus],
        is_up: Callable[[], bool],
        on_change: Callable[..., None],
        info: DeviceInfo,
        saved: Path | None = None,
    ) -> None:
        self.status = status
        self.is_up = is_up
        self.info = info
        self._on_change = on_change
        self._file = saved
        self._lock = Lock()
        self.power_up = _read(saved, factory) if saved is not None and saved.exists() else factory
        """Settings after the next power-up: the last saved ones, otherwise the factory's."""
        self.settings = self.power_up

    def change(self, update: Callable[[DeviceSettings], DeviceSettings], *, restarts: bool = False) -> None:
        """Replace the settings by `update(settings)`; raises the errors of `on_change`."""
        with self._lock:
            before = self.settings
            self.settings = after = update(before)
            if after == before and not restarts:
                return
            try:
                self._on_change(before, after, restarts=restarts)
            except Vlp16emuError:
                self.settings = before
                raise

    def adopt(self, update: Callable[[DeviceSettings], DeviceSettings]) -> None:
        """Replace the settings after the sensor has been set in another way, as by an event of the scene."""
        with self._lock:
            self.settings = update(self.settings)

    def restart(self) -> None:
        """Start again with the settings after power-up; unsaved settings are lost."""
        self.change(lambda _: self.power_up, restarts=True)

    def save(self) -> None:
        """Save the settings for the next power-up.

        Raises `OutputError` or `RunError` if the file cannot be written.
        """
        with self._lock:
            if self._file is not None:
                check_saved(self._file)
                with OutputFile(self._file) as output, output.writing() as file:
                    file.write(_SETTINGS.dump_json(self.settings, indent=2) + b"\n")
            self.power_up = self.settings


def explain_error(error: ValidationError) -> tuple[str, str, str]:
    """Return the field of the settings that an error is about, what was found and what was expected."""
    return explain(error, _SETTINGS.json_schema())


def check_saved(path: Path) -> None:
    """Raise OutputError if `path` is no regular file: a FIFO would make the stream wait for its reader."""
    if path.exists() and not path.is_file():
        raise OutputError(str(path), "is no regular file", "a file for saved settings, or a new name")


def _read(path: Path, factory: DeviceSettings) -> DeviceSettings:
    """Read saved settings; keys that the file lacks are the factory's."""
    expected = "settings that a sensor has saved"
    text = read_text(path, expected, InputError, most_bytes=_MOST_BYTES)
    try:
        tree = parse_json(text)
        if isinstance(tree, dict):
            tree = _SETTINGS.dump_python(factory, mode="json") | tree
        return _SETTINGS.validate_json(json.dumps(tree))
    except ValidationError as error:
        key, found, field_expected = explain_error(error)
        raise InputError(f"{path}: {key}", found, field_expected) from None
    except ValueError:
        raise InputError(str(path), "no JSON", expected) from None


_COUNTS_PER_V = 4096 / 5
_AMBIENT_C = 25.0  # of the surroundings
_BOTTOM_C = 51.1  # final temperatures of the boards
_TOP_C = 53.1
_WARM_UP_S = 150.0  # time constant of the boards' warm-up
_SWAY_C = 0.2  # amplitude of temperature changes
_REST_A = 0.20
_LASER_A = 0.10
_MOTOR_A_PER_RPM = 0.18 / 600
"""Current of the electronics, of the lasers and of the motor: together 0.48 A at 600 rpm."""
_RAILS = {
    "bot": {
        "pwr_1_2v": (1.2036, 11),
        "pwr_5v": (5.020 / 2, 13),
        "pwr_2_5v": (2.499, 17),
        "pwr_3_3v": (3.3032, 19),
        "pwr_v_in": (11.964 / 11, 23),
    },
    "top": {
        "hv": (5 - 181 / 101, 29),
        "ad_temp": (0.735, 31),
        "pwr_5v": (5.073 / 2, 37),
        "pwr_2_5v": (2.499, 41),
        "pwr_3_3v": (3.280, 43),
        "pwr_5v_raw": (5.347 / 2, 47),
        "pwr_vccint": (1.1914, 59),
    },
}
"""Volts at the converters of both boards, and the period of their small variation in seconds."""


def diagnostics(status: DeviceStatus) -> dict[str, object]:
    """Return `diag.json`: the counts of the converters in a state.

    Formulas: 63-9243 Rev D, sections 10.2.3.2 and 10.2.3.3. The values belong to healthy units; their
    variation is an assumption.
    """

    def counts(volts: float, period_s: int) -> int:
        """Return the reading of a voltage that sways slowly."""
        return round(volts * _COUNTS_PER_V + 0.8 * sine(period_s))

    def sine(period_s: int) -> float:
        """Return a sine of this period at the status's instant."""
        return math.sin(2 * math.pi * (status.t_ns % (period_s * S_NS)) / (period_s * S_NS))

    current_a = _REST_A + _LASER_A * status.laser_on + _MOTOR_A_PER_RPM * status.motor_rpm
    cold_share = math.exp(-status.powered_for_s / _WARM_UP_S)  # of the way from cold to warm, yet to come
    boards = {board: {name: counts(*rail) for name, rail in rails.items()} for board, rails in _RAILS.items()}
    boards["bot"] |= {"i_out": counts(2.5 + current_a / 10, 7), "pwr_1_25v": 0}
    for board, last_c, period_s in (("bot", _BOTTOM_C, 61), ("top", _TOP_C, 53)):
        board_c = last_c - (last_c - _AMBIENT_C) * cold_share + _SWAY_C * sine(period_s)
        # A voltage V means T = -1481.96 + sqrt(2.1962e6 + (1.8639 - V) / 3.88e-6).
        volts = 1.8639 - 3.88e-6 * ((board_c + 1481.96) ** 2 - 2.1962e6)
        boards[board]["lm20_temp"] = round(volts * _COUNTS_PER_V)
    return {"volt_temp": boards, "vhv": 412, "adc_nf": 14, "ixe": 1}


_FIRMWARE = Path(__file__).with_name("firmware.json")
"""Firmware images 3.0.41.1 and the fallback 1.9.3.0, and their states: invented, but consistent."""
_PARTS = {
    "/cgi/settings.json": "config",
    "/cgi/diag.json": "diag",
    "/cgi/status.json": "status",
    "/cgi/info.json": "info",
}
"""Documents that are read alone, and their names in the snapshot."""
_MOST_KEYS = 16


class FormError(ValueError):
    """A form that changes nothing, with the reason."""


def _whole_number(text: str) -> int:
    if not re.fullmatch(r"[0-9]{1,5}", text, re.ASCII):
        raise ValueError("a whole number")
    return int(text)


def _is_on(text: str) -> bool:
    if text not in ("on", "off"):
        raise ValueError("on or off")
    return text == "on"


def _return_mode(text: str) -> str:
    modes = {mode.capitalize(): str(mode) for mode in ReturnMode}
    if text not in modes:
        raise ValueError(" or ".join(modes))
    return modes[text]


def _switch_text(is_on: bool) -> str:
    return "On" if is_on else "Off"


def _with_phase_lock(settings: DeviceSettings, is_on: bool) -> DeviceSettings:
    return replace(settings, phase_lock_deg=settings.phase_lock_cdeg / 100 if is_on else "off")


def _with_phase(settings: DeviceSettings, cdeg: int) -> DeviceSettings:
    settings = replace(settings, phase_lock_cdeg=cdeg)
    return settings if settings.phase_lock_deg == "off" else _with_phase_lock(settings, is_on=True)


def _with_fov_start(settings: DeviceSettings, start_deg: int) -> DeviceSettings:
    return replace(settings, fov_deg=(start_deg, settings.fov_deg[1]))


def _with_fov_end(settings: DeviceSettings, end_deg: int) -> DeviceSettings:
    return replace(settings, fov_deg=(settings.fov_deg[0], end_deg))


class _Key(NamedTuple):
    """A key of a form and of the document of settings."""

    form: str  # last part of its form's path, and its table in the document; empty for the outermost
    name: str
    read: Callable[[str], Any]  # returns the value of a text of the form; ValueError with what is expected
    change: Callable[[DeviceSettings, Any], DeviceSettings]  # returns the settings with a value
    value_of: Callable[[DeviceSettings], object]  # returns the value in the document


def _field_key(
    form: str,
    name: str,
    field: str,
    read: Callable[[str], Any] = _whole_number,
    text_of: Callable[[Any], object] = str,
) -> _Key:
    """Return a key that stands for one field of the settings."""
    return _Key(
        form,
        name,
        read,
        lambda settings, value: replace(settings, **{field: value}),
        lambda settings: text_of(getattr(settings, field)),
    )


_KEYS = (
    _field_key("", "rpm", "rpm", text_of=int),
    _field_key("", "returns", "return_mode", _return_mode, str.capitalize),
    _field_key("", "laser", "laser", _is_on, _switch_text),
    _Key("fov", "start", _whole_number, _with_fov_start, lambda settings: settings.fov_deg[0]),
    _Key("fov", "end", _whole_number, _with_fov_end, lambda settings: settings.fov_deg[1]),
    _field_key("host", "addr", "host", str),
    _field_key("host", "dport", "data_port"),
    _field_key("host", "tport", "position_port"),
    _field_key("net", "addr", "address", str),
    _field_key("net", "mask", "mask", str),
    _field_key("net", "gateway", "gateway", str),
    _field_key("net", "dhcp", "dhcp", _is_on, _switch_text),
    _Key(
        "phaselock",
        "enabled",
        _is_on,
        _with_phase_lock,
        lambda settings: _switch_text(settings.phase_lock_deg != "off"),
    ),
    _Key("phaselock", "offset", _whole_number, _with_phase, lambda settings: str(settings.phase_lock_cdeg)),
)
_FORMS = {f"/cgi/setting/{key.form}".rstrip("/"): key.form for key in _KEYS}
_ACTIONS: Mapping[str, tuple[bytes, Callable[[Device], None]]] = {
    "/cgi/save": (b"submit", Device.save),
    "/cgi/reset": (b"reset_system", Device.restart),
}
PATHS = frozenset((*_FORMS, *_ACTIONS))
"""Paths that accept forms."""


def document(path: str, device: Device) -> object | None:
    """Return the present document of a path; None if there is none."""
    if path not in (*_PARTS, "/cgi/snapshot.hdl"):
        return None
    status = device.status()
    info = device.info
    motor = {
        "state": _switch_text(status.motor_on),
        "rpm": round(status.motor_rpm),
        "lock": _switch_text(status.phase_locked),
    }
    unit = {"model": MODELS[info.model].title, "serial": info.serial, "mac_addr": info.mac.hex("-")}
    firmware: dict[str, object] = json.loads(_FIRMWARE.read_text(encoding="utf-8"))
    snapshot = {
        "config": _settings_tree(device.settings),
        "diag": diagnostics(status),
        "status": {
            "gps": {"pps_state": status.pps.name.capitalize(), "position": status.position},
            "motor": motor | {"phase": status.phase_cdeg},
            "laser": {"state": _switch_text(status.laser_on)},
        },
        "info": unit | firmware,
    }
    return snapshot[_PARTS[path]] if path in _PARTS else snapshot


def submit(path: str, body: bytes, device: Device) -> None:
    """Apply a form of one of `PATHS`, as a whole or not at all.

    Raises `FormError` if it has a key or a value that the sensor does not accept; other errors as in
    `Device`.
    """
    if path in _ACTIONS:
        word, act = _ACTIONS[path]
        if body not in (word, b"data=" + word):
            raise FormError(f"body: found {_quote(body)}, expected {word.decode()}")
        act(device)
        return
    try:
        pairs = parse_qsl(
            body.decode("ascii"), keep_blank_values=True, strict_parsing=True, max_num_fields=_MOST_KEYS
        )
    except ValueError:
        pairs = []
    if not pairs:
        raise FormError(f"body: found {_quote(body)}, expected key=value")
    device.change(partial(_with_form, _FORMS[path], pairs))


def _with_form(form: str, pairs: Sequence[tuple[str, str]], settings: DeviceSettings) -> DeviceSettings:
    """Return settings with the keys and values of a form; FormError for a bad one."""
    keys = {key.name: key for key in _KEYS if key.form == form}
    for name, text in pairs:
        if name not in keys:
            raise FormError(f"{name[:40]!r}: unknown key, expected {' or '.join(keys)}")
        key = keys[name]
        try:
            settings = key.change(settings, key.read(text))
        except ValidationError as error:
            _, found, expected = explain_error(error)
            raise FormError(f"{name}: {found}, expected {expected}") from None
        except ValueError as error:
            raise FormError(f"{name}: found {text[:40]!r}, expected {error}") from None
    return settings


def _quote(body: bytes) -> str:
    return repr(body[:40].decode("ascii", "replace"))


def _settings_tree(settings: DeviceSettings) -> Tree:
    """Return the settings with the types of real units: ports and the phase are strings."""
    tree = Tree()
    for key in _KEYS:
        table = tree.setdefault(key.form, {}) if key.form else tree
        table[key.name] = key.value_of(settings)
    return tree

"""The sensor as its web interface sees it: what is set, what is saved, and how it is at an instant."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from ipaddress import IPv4Address
from pathlib import Path
from threading import Lock
from typing import Annotated

from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass as checked_dataclass

from vlp16emu.errors import InputError, Vlp16emuError, readable
from vlp16emu.explain import explain
from vlp16emu.output import OutputFile
from vlp16emu.sensor.settings import Address, Port
from vlp16emu.types import PpsState, ReturnMode, SensorModel

_ALL_ONES = 0xFFFF_FFFF
_MOST_BYTES = 10_000  # of saved settings, which are some 400


def _address(expected: str, is_good: Callable[[IPv4Address], bool]) -> AfterValidator:
    def checked(text: str) -> str:
        try:
            known = IPv4Address(text)
        except ValueError:
            raise ValueError(expected) from None
        if not is_good(known):
            raise ValueError(expected)
        return str(known)

    return AfterValidator(checked)


def _has_ones_first(mask: IPv4Address) -> bool:
    zeros = int(mask) ^ _ALL_ONES
    return bool(int(mask)) and not zeros & (zeros + 1)


_Receiver = _address(
    "the IPv4 address of a host, or 255.255.255.255",
    lambda at: not (at.is_unspecified or at.is_multicast or (at.is_reserved and int(at) != _ALL_ONES)),
)
_Gateway = _address("the IPv4 address of a router, or 0.0.0.0", lambda at: not (at.is_multicast or at.is_reserved))
_Mask = _address("a network mask such as 255.255.255.0", _has_ones_first)
_WholeDegree = Annotated[int, Field(ge=0, le=359)]


@checked_dataclass(frozen=True, slots=True, config=ConfigDict(strict=True, extra="forbid"))
class DeviceSettings:
    """Settings of the web interface, with the defaults of the factory (63-9243 Rev D, section 10.2).

    Raises
    ------
    pydantic.ValidationError
        If a value is none that the sensor takes; also from `dataclasses.replace`
    """

    rpm: Annotated[int, Field(ge=300, le=1200, multiple_of=60)] = 600
    """Speed of the rotor; others upset speed control and phase lock (section 8.3)."""
    return_mode: ReturnMode = ReturnMode.STRONGEST
    """Echoes that are sent."""
    laser_on: bool = True
    """False: no data packets; position packets go on."""
    fov_deg: tuple[_WholeDegree, _WholeDegree] = (0, 359)
    """First and last azimuth that is sent; (0, 359) is all around."""
    phase_lock_on: bool = False
    """Whether the rotor follows the pulse of the GPS receiver."""
    phase_lock_cdeg: Annotated[int, Field(ge=0, le=35_999)] = 0
    """Rotor angle at each pulse, in 0.01 degree."""
    host: Annotated[str, _Receiver] = "255.255.255.255"
    """IPv4 address that packets are sent to."""
    data_port: Port = 2368
    """Destination port of data packets."""
    position_port: Port = 8308
    """Destination port of position packets."""
    address: Address = "192.168.1.201"
    """IPv4 address of the sensor."""
    mask: Annotated[str, _Mask] = "255.255.255.0"
    """Of its network."""
    gateway: Annotated[str, _Gateway] = "192.168.1.1"
    """Of its network."""
    dhcp: bool = False
    """Whether it asks a server for them."""


_SETTINGS: TypeAdapter[DeviceSettings] = TypeAdapter(DeviceSettings)


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """Constants of a unit: names, versions, serial number."""

    serial: str
    """Digits, as on the label."""
    model: SensorModel
    mac: bytes
    """6 bytes."""


@dataclass(frozen=True, slots=True)
class DeviceStatus:
    """The sensor at an instant."""

    t_ns: int
    """UTC of the emulated instant."""
    pps: PpsState
    position: str
    """As the sensor writes it, such as `49 00.00N 200 .00W`; empty without a fix."""
    motor_rpm: float
    motor_on: bool
    phase_locked: bool
    phase_cdeg: int
    """Rotor angle at the latest pulse, in 0.01 degree."""
    laser_on: bool
    powered_for_s: float
    """Since power-up: boards warm up."""
    is_up: bool = True
    """False while it starts: nothing answers."""
    disabled: bool = False
    """Motor and laser are switched off by a fault; the web interface lives on, and shows zeros."""


class Device:
    """The settings of one sensor, for all threads that read and change them.

    Parameters
    ----------
    factory : what is set where nothing has been saved
    status : gives the sensor as it is now; called from the thread of the web server, and must not wait
    is_up : returns whether the sensor answers; for a `status` that costs more
    changed : called at each change as `changed(before, after, restarts=False)`, with `restarts` where the sensor starts
        again; must not wait; if it raises, nothing changes
    info : serial number and the like
    saved : file that saved settings are kept in from run to run; None to keep them for this run

    Raises
    ------
    InputError
        If the file is none that has been saved
    """

    def __init__(
        self,
        factory: DeviceSettings,
        *,
        status: Callable[[], DeviceStatus],
        changed: Callable[..., None],
        info: DeviceInfo,
        is_up: Callable[[], bool] | None = None,
        saved: Path | None = None,
    ) -> None:
        self.status, self.info, self.is_up = status, info, is_up or (lambda: status().is_up)
        self._changed, self._file = changed, saved
        self._lock = Lock()
        self._power_up = _read(saved, factory) if saved is not None and saved.exists() else factory
        self._settings = self._power_up

    @property
    def settings(self) -> DeviceSettings:
        """Present settings."""
        return self._settings

    @property
    def power_up(self) -> DeviceSettings:
        """Settings after the next power-up: those that were saved last, otherwise those of the factory."""
        return self._power_up

    def change(self, made: Callable[[DeviceSettings], DeviceSettings], *, restarts: bool = False) -> None:
        """Replace the settings by `made(settings)`; errors as of `changed`."""
        with self._lock:
            before = self._settings
            self._settings = after = made(before)
            if after == before and not restarts:
                return
            try:
                self._changed(before, after, restarts=restarts)
            except Vlp16emuError:
                self._settings = before
                raise

    def adopt(self, made: Callable[[DeviceSettings], DeviceSettings]) -> None:
        """Replace the settings as the sensor has already been set by another way, such as an event of the scene."""
        with self._lock:
            self._settings = made(self._settings)

    def restart(self) -> None:
        """Start again from the settings after power-up; those that are not saved are lost."""
        self.change(lambda _: self._power_up, restarts=True)

    def save(self) -> None:
        """Keep what is set for the next power-up; `OutputError` or `RunError` if the file cannot be written."""
        with self._lock:
            if self._file is not None:
                with OutputFile(self._file) as output, output.writing() as file:
                    file.write(_SETTINGS.dump_json(self._settings, indent=2) + b"\n")
            self._power_up = self._settings


def explained(error: ValidationError) -> tuple[str, str, str]:
    """Field of the settings, what was found and what was expected."""
    return explain(error, _SETTINGS.json_schema())


def _read(path: Path, factory: DeviceSettings) -> DeviceSettings:
    """Read settings that were saved; keys that are left out are the factory's."""
    expected = "settings that a sensor has saved"
    with readable(path, expected, InputError, most_bytes=_MOST_BYTES):
        text = path.read_text(encoding="utf-8")
    try:
        tree = json.loads(text)
        if isinstance(tree, dict):
            tree = _SETTINGS.dump_python(factory, mode="json") | tree
        return _SETTINGS.validate_json(json.dumps(tree))
    except ValidationError as error:
        key, found, wanted = explained(error)
        raise InputError(f"{path}: {key}", found, wanted) from None
    except (ValueError, RecursionError):
        raise InputError(str(path), "no JSON", expected) from None

"""The JSON documents of the web interface (63-9243 Rev D, section 10.2; fields and types as units send them)."""

from vlp16emu.extras.bench.diagnostics import diagnostics
from vlp16emu.extras.bench.state import Device, DeviceInfo, DeviceSettings, DeviceStatus
from vlp16emu.types import SensorModel

_MODELS = {SensorModel.VLP_16: "VLP-16", SensorModel.PUCK_LITE: "Puck LITE", SensorModel.PUCK_HI_RES: "Puck Hi-Res"}
"""The first is on record; the others are named as their data sheets do (assumption)."""

_SIGNATURE = 0xA5A5A5A5
_VERSION, _FAILSAFE_VERSION = 0x0300_2901, 0x0109_0300
"""Firmware 3.0.41.1, and 1.9.3.0 to fall back on."""
_BUILT_S, _FAILSAFE_BUILT_S = 1_528_900_000, 1_352_183_794
"""Seconds since 1970."""
_BOTTOM_ID, _TOP_ID = 0x4844_4C43, 0x4448_4C50


_PARTS = {
    "/cgi/settings.json": "config",
    "/cgi/diag.json": "diag",
    "/cgi/status.json": "status",
    "/cgi/info.json": "info",
}
"""What is read alone, and its name in the snapshot of all."""


def document(path: str, device: Device) -> object | None:
    """Make the document of a path, as it is now; None if there is none."""
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


def _settings(settings: DeviceSettings) -> dict[str, object]:
    """Write what is set; numbers of ports and of the phase are texts."""
    start, end = settings.fov_deg
    return {
        "laser": _switch(settings.laser_on),
        "returns": settings.return_mode.capitalize(),
        "rpm": settings.rpm,
        "fov": {"start": start, "end": end},
        "phaselock": {"enabled": _switch(settings.phase_lock_on), "offset": str(settings.phase_lock_cdeg)},
        "host": {"addr": settings.host, "dport": str(settings.data_port), "tport": str(settings.position_port)},
        "net": {
            "addr": settings.address,
            "mask": settings.mask,
            "gateway": settings.gateway,
            "dhcp": _switch(settings.dhcp),
        },
    }


def _status(status: DeviceStatus) -> dict[str, object]:
    """Write how the sensor is."""
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
    """Write what the sensor is; its firmware is invented, and of one piece."""
    fpga, app = {"version": _VERSION, "timestamp": 0}, {"version": _VERSION, "timestamp": _BUILT_S}
    return {
        "model": _MODELS[info.model],
        "serial": info.serial,
        "mac_addr": info.mac.hex("-"),
        "image": {
            "failsafe": _image(_FAILSAFE_VERSION, _FAILSAFE_BUILT_S, 293_836, 0xF11A_2C36, 0xB9AA_3C95),
            "application": _image(_VERSION, _BUILT_S, 412_208, 0x5B6E_91D4, 0x2F80_77A1),
        },
        "sysid": {"bot": {"id": _BOTTOM_ID, "timestamp": _BUILT_S}, "top": {"id": _TOP_ID, "timestamp": _BUILT_S}},
        "state": {"bot": _state(0x0100_0000, 118_489_096), "top": _state(0x000E_0000, 262_144_008)},
        "fpgaid": {"bot": {"id": 2} | fpga, "top": {"id": 1} | fpga},
        "appid": {"bot": {"type": 2} | app, "top": {"type": 1} | app},
    }


def _image(version: int, built_s: int, length_bytes: int, data_crc: int, header_crc: int) -> dict[str, int]:
    """Write the header of a firmware image, which is made for the system of the base."""
    keys = ("signature", "version", "timestamp", "data_length", "data_crc", "res1", "res2", "header_crc")
    made_for = (_BOTTOM_ID, built_s)
    return dict(zip(keys, (_SIGNATURE, version, built_s, length_bytes, data_crc, *made_for, header_crc), strict=True))


def _state(application: int, watchdog: int) -> dict[str, int]:
    idle = ("factorymode", "powerup", "runconfig", "wdtimer", "nstatus", "crcerr", "nconfig")
    running = {"appmode": 1, "wden": 1, "prevaddr": 0, "appaddr": application, "wdto": watchdog}
    return dict.fromkeys(idle, 0) | running


def _switch(on: bool) -> str:
    return "On" if on else "Off"

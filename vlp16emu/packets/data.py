"""Data packets: conversion of metres, degrees and nanoseconds into 1206 bytes.

Every step is elementwise in float64 and correctly rounded, so the bytes of a packet do not depend on
the other packets.
"""

from typing import TypeVar

import numpy as np

from vlp16emu.errors import InputError
from vlp16emu.packets import layout
from vlp16emu.packets.layout import layout_of
from vlp16emu.sensor.beams import Model
from vlp16emu.types import F4, F8, I8, U1, U2, AnyArray, Packet, PacketKind, ReturnMode, Returns, SensorModel
from vlp16emu.units import HOUR_NS, US_NS

_Time = TypeVar("_Time", int, I8)
_STRONGEST = 0  # last axis of Returns
_LAST = 1
_SECOND_STRONGEST = 2


def pack_data(returns: Returns, mode: ReturnMode, model: SensorModel, unit: int = 0) -> list[Packet]:
    """Pack whole packets of a unit of the rig, of a VLP-16 k / 24 or k / 12 of them.

    Other parameters and errors are those of `data_payloads`. `due_ns` is the end of a packet's last firing
    sequence: on a VLP-16 1327.104 us after its first pulse, or 663.552 us in dual return, if no sequence is
    left out.
    """
    payloads = data_payloads(returns, mode, model)
    of_model = layout_of(model, mode)
    sequences = of_model.sequences
    fired_ns = returns.firings.t_ns[::sequences, 0]
    due_ns = returns.firings.t_ns[sequences - 1 :: sequences, 0] + of_model.model.beams.sequence_ns
    return [
        Packet(PacketKind.DATA, due, payload.tobytes(), unit, fired)
        for due, payload, fired in zip(due_ns.tolist(), payloads, fired_ns.tolist(), strict=True)
    ]


def returns_in(packet: Packet) -> int:
    """Count the nonzero distances of a data packet; 0 for other packets and truncated ones."""
    if packet.kind is not PacketKind.DATA or len(packet.payload) != layout.DATA_BYTES:
        return 0
    fields = np.frombuffer(packet.payload, layout.DATA_PAYLOAD)
    return int(np.count_nonzero(fields["blocks"]["records"]["distance_lsb"]))


def data_payloads(returns: Returns, mode: ReturnMode, model: SensorModel) -> U1:
    """Pack whole packets into bytes, (n, 1206), one payload per row.

    Parameters
    ----------
    returns : k firing sequences of L lasers in whole packets: k is a multiple of `Layout.sequences`
    mode : which returns are sent
    model : sensor model

    Raises InputError unless angles and distances are finite and not negative; ValueError unless there are L
    lasers and whole packets.
    """
    _check(returns)
    firings = returns.firings
    of_model = layout_of(model, mode)
    packets = np.zeros(len(firings.t_ns) // of_model.sequences, layout.DATA_PAYLOAD)
    codes = azimuth_cdeg(firings.reading_deg[:: of_model.per_reading])
    codes = codes.reshape(len(packets), of_model.readings)
    blocks = packets["blocks"]
    used = of_model.by_reading(blocks)  # (n, readings, banks, copies)
    used["flag"] = np.array(of_model.model.flags)[:, None]
    blocks["azimuth_cdeg"] = codes[:, -1:]  # of blocks that hold nothing
    used["azimuth_cdeg"] = codes[:, :, None, None]
    if mode is ReturnMode.DUAL:
        last = used["records"][..., 0, :]
        other = used["records"][..., 1, :]
        _write(last, returns.distance_m[..., _LAST], returns.reflectivity[..., _LAST], of_model.model)
        place = odd_column(returns)[..., None]
        distance_m = np.take_along_axis(returns.distance_m, place, axis=-1)
        _write(other, distance_m, np.take_along_axis(returns.reflectivity, place, axis=-1), of_model.model)
    else:
        column = _LAST if mode is ReturnMode.LAST else _STRONGEST
        columns = returns.distance_m[..., column], returns.reflectivity[..., column]
        _write(used["records"], *columns, of_model.model)
    stamped_ns = firings.clock_ns[:: of_model.sequences] + of_model.model.stamp_after_ns
    packets["timestamp_us"] = timestamp_us(stamped_ns)
    packets["return_mode"] = layout.RETURN_MODE_BYTE[mode]
    packets["factory"] = of_model.model.product
    return packets.view(np.uint8).reshape(-1, layout.DATA_BYTES)


def timestamp_us(clock_ns: _Time) -> _Time:
    """Return microseconds past the hour of the sensor's clock, any shape, as in both kinds of packet.

    They are floored, and below 3.6e9. Real units floor a time that is exact in
    nanoseconds: their steps are 1327 and 1328 us with a mean of 1327.10. Source: 63-9243 Rev D, section 9.3.1
    and appendix G (the counter).
    """
    return clock_ns % HOUR_NS // US_NS


def _check(returns: Returns) -> None:
    for name, values in (
        ("firings.reading_deg", returns.firings.reading_deg),
        ("distance_m", returns.distance_m),
    ):
        low, high = values.min(initial=0.0), values.max(initial=0.0)  # both propagate NaN
        if not (low >= 0.0 and high < np.inf):
            raise InputError(f"pack_data: {name}", f"from {low} to {high}", "finite numbers from 0 upwards")


def azimuth_cdeg(reading_deg: F8) -> U2:
    """Rotor angle in whole hundredths of a degree, 0 .. 35999."""
    # 1e-8 deg: without it 0.29, an exact code, becomes 28, because 0.29 * 100 < 29 in binary.
    code = np.floor(reading_deg * 100.0 + 1e-6)
    return (code % layout.AZIMUTH_CODES).astype(np.uint16)


def odd_column(returns: Returns) -> I8:
    """Index (k, L) on the last axis of `Returns` for the odd blocks of dual return.

    It selects the strongest return; the second strongest if the strongest is also the last; and if there is
    only one return, that one again. Source: 63-9243 Rev D, section 9.3.2, p. 57; the repetition is as on
    a real unit.
    """
    strongest_is_last = returns.distance_m[..., _STRONGEST] == returns.distance_m[..., _LAST]
    # A return nearer than 0.5 m has no distance, but keeps its reflectivity.
    second_m = returns.distance_m[..., _SECOND_STRONGEST]
    second = returns.reflectivity[..., _SECOND_STRONGEST]
    has_second = (second_m > 0) | (second > 0)
    return np.where(strongest_is_last & has_second, _SECOND_STRONGEST, _STRONGEST)


def _write(records: AnyArray, distance_m: F4, reflectivity: U1, model: Model) -> None:
    """Fill records (n, readings, banks, ..., 32) from metres and reflectivity (k, L).

    Reflectivity is written without a distance too, as real units do.
    """
    records["distance_lsb"] = distance_lsb(distance_m, model).reshape(records.shape)
    records["reflectivity"] = reflectivity.reshape(records.shape)


def distance_lsb(distance_m: F4, model: Model) -> U2:
    """Distances in the model's steps, 2 or 4 mm; 0 if nearer than its least or beyond the largest code."""
    code = np.rint(distance_m.astype(np.float64) / model.distance_lsb_m)
    seen = (code >= model.minimum_lsb) & (code <= np.iinfo(np.uint16).max)
    return np.where(seen, code, 0).astype(np.uint16)

"""Decoding of both packets: data packets become points by the manual's formulas.

With distance R, azimuth a, elevation w and the laser's vertical correction c the manual has X = R cos w sin a
to the right, Y = R cos w cos a forward and Z = R sin w + c up (63-9243 Rev D, sections 9.1 and 9.2, p. 52 to
54). Points here are in the `sensor` frame, as in ROS drivers: x = Y forward, y = -X left, z = Z.
"""

import struct
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.errors import PacketError
from vlp16emu.packets import layout
from vlp16emu.packets.layout import (
    BLOCK_PERIOD_NS,
    BLOCKS_PER_PACKET,
    PRODUCT_BEFORE_RELEASE,
    PRODUCT_WORDS,
    PRODUCTS,
    Layout,
    layout_of_bytes,
)
from vlp16emu.packets.pulses import fill_points
from vlp16emu.sensor.settings import MOST_RPM
from vlp16emu.types import F4, F8, I8, U1, PpsState, ReturnMode, SensorModel
from vlp16emu.units import S_NS, US_NS

SENSOR_R_MANUAL = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Rotation from the manual's frame, azimuth 0 on +y, to the sensor's, azimuth 0 on +x."""

_MAX_STEP_CDEG = 100
"""A wider step from reading to reading is the edge of a limited field of view: the fastest speed, 1200 rpm,
gives a VLP-16 79.6, and others half of it."""
_BEFORE_RELEASE_US = 1_327, 1_328, 663, 664  # steps of the stamps of a VLP-16

_FASTEST_DEG_PER_NS = 1.5 * MOST_RPM * 6 / S_NS
"""Fastest rotor, with a margin for units that run too fast."""
_POSITION = struct.Struct(f"<IB3x{layout.SENTENCE_BYTES}s")
_POSITION_AT: int = layout.POSITION_PAYLOAD.fields["timestamp_us"][1]  # type: ignore[index]  # it has fields
JUMP_NS = S_NS // 4  # a longer step of the clock ends a revolution: the slowest, at 300 rpm, takes 0.2 s


class PointFrame(StrEnum):
    """Axes of points in the sensor's frame."""

    SENSOR = "sensor"  # x forward at azimuth 0, y left, z up (REP 103), as in ROS drivers
    MANUAL = "manual"  # x right, y forward at azimuth 0, z up (63-9243 Rev D, section 9.1)


class Fault(NamedTuple):
    """Reason why a data packet is not from a sensor whose packets are known, or from another one."""

    packet: int  # Row of the payload
    what: str
    found: str
    expected: str


@dataclass(frozen=True, slots=True)
class Points:
    """n records in the order of their pulses; in dual return the even block's record comes first."""

    packet: I8  # (n,) row of the payload
    slot: I8  # (n,) position of the record in its packet: 32 * block + channel
    since_ns: I8  # (n,) time of the pulse since the stamp of its packet, on most models its first pulse
    time_ns: I8  # (n,) time of the pulse on the sensor's clock, ns past its hour
    laser: U1  # (n,) in wire order, on a VLP-16 0..15
    ring: U1  # (n,) by elevation, 0 the lowest
    azimuth_deg: F8  # (n,) azimuth of the beam at the instant of the pulse, [0, 360)
    distance_m: F4  # (n,) from the centre of the sensor; 0 without return
    xyz_m: F4  # (n, 3) sensor frame: x forward at azimuth 0, y left, z up; NaN without return
    reflectivity: U1  # (n,) 0..100 diffuse, 101..255 retroreflective
    is_last: NDArray[np.bool_]
    """(n,) True for a last return. Else it is the strongest, or in dual return, if the strongest is also the
    last, the second strongest or the same return again."""


@dataclass(frozen=True, slots=True)
class PositionFields:
    """Fields of a position packet."""

    time_ns: int  # The sensor's clock, ns past its hour, whole microseconds
    pps: PpsState
    sentence: bytes  # Sentence with CR LF; empty if none was received


def data_fields(payloads: U1) -> NDArray[np.void]:
    """View payloads, (n, 1206) uint8, by their fields, (n,) `DATA_PAYLOAD`.

    Raises PacketError for another shape or dtype.
    """
    if payloads.dtype != np.uint8 or payloads.shape[1:] != (layout.DATA_BYTES,):
        raise PacketError("data packets", f"{payloads.shape} {payloads.dtype}", "(n, 1206) uint8")
    return np.ascontiguousarray(payloads).view(layout.DATA_PAYLOAD)[:, 0]


def decode_data(payloads: U1, *, keep_no_returns: bool, model: SensorModel | None = None) -> Points:
    """Convert data packets into points.

    A pulse's azimuth is its reading plus the rotation until the pulse, at the packet's mean speed (63-9243
    Rev D, section 9.5, p. 65), and the laser's azimuth offset. Each packet is converted on its own; only
    packets with a single reading take their speed from the packet before.

    Parameters
    ----------
    payloads : (n, 1206) uint8, of one sensor, in order of sending; the return mode may change
    keep_no_returns : whether pulses without return also become records
    model : sensor model of prototype units, whose product byte names another sensor

    Raises PacketError for packets of other sensors than those of `SensorModel`, or of two models.
    """
    fields = data_fields(payloads)
    if faults := faults_in(fields, None, model):
        raise PacketError(f"data packet {faults[0].packet}: {faults[0].what}", *faults[0][2:])
    return points_in(fields, model, keep_no_returns=keep_no_returns, keep_repeats=True)


def points_in(
    fields: NDArray[np.void],
    model: SensorModel | None = None,
    frame: PointFrame = PointFrame.SENSOR,
    *,
    keep_no_returns: bool = False,
    keep_repeats: bool = False,
) -> Points:
    """Convert data packets, (n,) `DATA_PAYLOAD` without faults, into points, as `decode_data`.

    In dual return a single echo is in both records of its pulse (63-9243 Rev D, section 9.3.2); it is one
    point, of the even block, unless `keep_repeats`.
    """
    single, dual = layouts_of(fields, model)
    beams = single.model.beams
    rows = np.ascontiguousarray(fields).view(np.uint8).reshape(len(fields), fields.dtype.itemsize)
    most = layout.RECORDS_PER_PACKET * len(fields)
    numbers = np.empty((4, most), np.int64)
    codes = np.empty((3, most), np.uint8)
    azimuth_deg = np.empty(most)
    distance_m = np.empty(most, np.float32)
    xyz_m = np.empty((most, 3), np.float32)
    angles = beams.elevation_deg, beams.vertical_offset_m, 100.0 * beams.azimuth_offset_deg
    count = fill_points(
        rows,
        rows.shape[1] - layout.DATA_BYTES,
        single.places,
        dual.places,
        single.reading_ns,
        single.model.distance_lsb_m,
        _steps_cdeg(fields, model),
        np.array([*angles, *np.zeros((2, single.model.lasers))]),
        SENSOR_R_MANUAL.T.copy() if frame is PointFrame.MANUAL else np.zeros((0, 0)),
        keep_no_returns,
        keep_repeats,
        numbers,
        codes,
        *(azimuth_deg, distance_m, xyz_m),
    )
    packet, slot, since_ns, time_ns = numbers[:, :count]
    laser, reflectivity, is_last = codes[:, :count]
    return Points(
        packet=packet,
        slot=slot,
        since_ns=since_ns,
        time_ns=time_ns,
        laser=laser,
        ring=beams.ring.astype(np.uint8)[laser],
        azimuth_deg=azimuth_deg[:count],
        distance_m=distance_m[:count],
        xyz_m=xyz_m[:count],
        reflectivity=reflectivity,
        is_last=is_last.view(np.bool_),
    )


def faults_in(
    fields: NDArray[np.void], factory: int | None = None, model: SensorModel | None = None
) -> list[Fault]:
    """Find packets of unknown sensors, or of another model than the others.

    Return the first fault of each.

    Parameters
    ----------
    fields : (n,) `DATA_PAYLOAD`
    factory : product byte of earlier packets, if any
    model : sensor model of prototype units, whose product byte names another sensor
    """
    flags = fields["blocks"]["flag"]
    azimuth_cdeg = fields["blocks"]["azimuth_cdeg"]
    products = fields["factory"]
    modes = [*layout.RETURN_MODE_BYTE.values()]
    known = [*PRODUCTS]
    expected_product = PRODUCT_WORDS
    if factory is None and model is None and is_before_release(fields):
        known.remove(PRODUCT_BEFORE_RELEASE)
        expected_product = "`vlp16emu decode --model` for a VLP-16 from before release"
    first = _first_product(products, known) if factory is None and len(products) else factory
    right_flags = _flags(fields, first, model)
    expected_flag = "0xeeff" if len(np.unique(right_flags)) == 1 else "the flag of the block"
    for_what: tuple[tuple[str, NDArray[Any], NDArray[np.bool_], str], ...] = (
        ("block flag", flags, (flags == right_flags) | (right_flags == 0), expected_flag),
        ("return mode", fields["return_mode"], np.isin(fields["return_mode"], modes), "0x37, 0x38 or 0x39"),
        ("product", products, np.isin(products, known), expected_product),
        ("product", products, products == first, f"{first:#x} as of the others" if first else ""),
        # Old firmware sends 36000 for 0.
        ("azimuth", azimuth_cdeg, azimuth_cdeg <= layout.AZIMUTH_CODES, "0 to 36000 hundredths of a degree"),
    )
    faults = dict[int, Fault]()
    for what, codes, right, expected in for_what:
        for packet, *place in np.argwhere(~right).tolist():
            faults.setdefault(packet, Fault(packet, what, f"{codes[packet, *place]:#x}", expected))
    return [faults[packet] for packet in sorted(faults)]


def _first_product(products: U1, known: list[int]) -> int:
    """Return the first known product byte; the ambiguous one only if there is no other."""
    for codes in ([code for code in known if code != PRODUCT_BEFORE_RELEASE], known):
        ours = products[np.isin(products, codes)]
        if len(ours):
            return int(ours[0])
    return int(products[0])


def is_before_release(fields: NDArray[np.void]) -> bool:
    """Return True if all packets have an HDL-32E's product byte, but are as far apart as a VLP-16's."""
    if len(fields) < 2 or not (fields["factory"] == PRODUCT_BEFORE_RELEASE).all():
        return False
    step_us = np.median(np.diff(fields["timestamp_us"].astype(np.int64)))
    return bool(np.isin(step_us, _BEFORE_RELEASE_US))


def _flags(fields: NDArray[np.void], product: int | None, model: SensorModel | None) -> I8:
    """Return the right flags (n, 12) of blocks; 0 for those that hold nothing."""
    right = np.zeros((2, BLOCKS_PER_PACKET), np.int64)
    for of_mode, flags in zip(_layouts(product, model), right, strict=True):
        of_mode.by_reading(flags[None])[:] = np.array(of_mode.model.flags)[:, None]
    return right[is_dual(fields).astype(np.int64)]


def scan_starts(azimuth_deg: F8, t_ns: I8 | None = None) -> I8:
    """Find the starts of scans (m,) in azimuths (n,) of points or blocks.

    A scan starts at the first one, at each wrap, and after a jump of time. With times (n,) a decrease of the
    azimuth is a wrap only if the rotor can complete the revolution in the time between.
    """
    turns, jumps = scan_steps(azimuth_deg, t_ns)
    scan = np.maximum.accumulate(np.cumsum(turns)) + np.cumsum(jumps)
    return np.flatnonzero(
        np.diff(np.concatenate([np.zeros(min(1, len(azimuth_deg)), np.int64), scan]), prepend=-1)
    )


def scan_steps(azimuth_deg: F8, t_ns: I8 | None = None) -> tuple[I8, I8]:
    """Return the revolutions (n - 1,) that are completed from each azimuth (n,) to the next, and the jumps.

    A revolution is -1 where the rotor steps back across the wrap; a jump of time is 1.
    """
    step_deg = np.diff(azimuth_deg)
    if t_ns is None:
        jumps = np.zeros(len(step_deg), np.int64)
        can_turn_deg = np.full(len(step_deg), 359.0)
        in_packet = np.zeros(len(step_deg), np.bool_)
    else:
        step_ns = np.diff(t_ns)
        jumps = (np.abs(step_ns) > JUMP_NS).astype(np.int64)
        can_turn_deg = 1.0 + _FASTEST_DEG_PER_NS * np.clip(step_ns, 0, JUMP_NS)
        in_packet = (step_ns > 0) & (step_ns <= BLOCK_PERIOD_NS)
    # The rotor only turns forward: a decrease is a wrap, except for encoder noise (0.01 deg) and late
    # packets, and an increase that the rotor cannot make is a step back across the wrap. Two blocks of a
    # packet may have a gap of azimuths that are not sent between them, which their times do not show.
    wrap = (step_deg < -1.0) & ((step_deg + 360.0 <= can_turn_deg) | in_packet)
    turns: I8 = wrap.astype(np.int64) - ((step_deg > 180.0) & (step_deg > can_turn_deg))
    return turns, jumps


def decode_position(payload: bytes) -> PositionFields:
    """Read one position packet.

    Raises PacketError for another length than 512 bytes, or a pulse-per-second state other than 0..3.
    """
    if len(payload) != layout.POSITION_BYTES:
        raise PacketError("position packet", f"{len(payload)} bytes", f"{layout.POSITION_BYTES}")
    stamp_us, state, sentence = _POSITION.unpack_from(payload, _POSITION_AT)
    try:
        pps = PpsState(state)
    except ValueError:
        raise PacketError("position packet: PPS state", f"{state}", "0 to 3") from None
    return PositionFields(time_ns=stamp_us * US_NS, pps=pps, sentence=sentence.split(b"\0", 1)[0])


def layouts_of(fields: NDArray[np.void], model: SensorModel | None = None) -> tuple[Layout, Layout]:
    """Return the layouts in single and in dual return of the model of the first packet's product byte.

    It is `model` for the byte of a prototype unit.
    """
    return _layouts(int(fields["factory"][0]) if len(fields) else None, model)


def _layouts(product: int | None, model: SensorModel | None) -> tuple[Layout, Layout]:
    codes = layout.RETURN_MODE_BYTE
    single, dual = (
        layout_of_bytes(codes[mode], -1 if product is None else product, model)
        for mode in (ReturnMode.STRONGEST, ReturnMode.DUAL)
    )
    return single, dual


def is_dual(fields: NDArray[np.void]) -> NDArray[np.bool_]:
    """Return a mask (n,) of packets in dual return."""
    return np.asarray(fields["return_mode"] == layout.RETURN_MODE_BYTE[ReturnMode.DUAL])


def readings_in(fields: NDArray[np.void], model: SensorModel | None = None) -> I8:
    """Return the azimuth reading (n, 12) of each block in its packet; of blocks that hold nothing -1."""
    readings = np.full((2, BLOCKS_PER_PACKET), -1, np.int64)
    for of_mode, reading in zip(layouts_of(fields, model), readings, strict=True):
        of_mode.by_reading(reading[None])[:] = np.arange(of_mode.readings)[:, None, None]
    return readings[is_dual(fields).astype(np.int64)]


def block_since_ns(fields: NDArray[np.void], model: SensorModel | None = None) -> I8:
    """Return the time (n, 12) of the azimuth reading of each block since the stamp of its packet.

    Blocks share it in dual return, and if a firing sequence has several. That of blocks that hold nothing is
    the last one's.
    """
    single, _ = layouts_of(fields, model)
    reading = np.maximum.accumulate(readings_in(fields, model), axis=1)
    return reading * single.reading_ns - single.model.stamp_after_ns


def repeats_in(fields: NDArray[np.void]) -> NDArray[np.bool_]:
    """Return a mask (n, 12, 32) of records in dual return that repeat the record of the block before."""
    distance_lsb = fields["blocks"]["records"]["distance_lsb"]
    last_lsb = distance_lsb[:, 0::2]
    repeated = np.zeros(distance_lsb.shape, np.bool_)
    repeated[:, 1::2] = (distance_lsb[:, 1::2] == last_lsb) & (last_lsb > 0)
    repeated[~is_dual(fields)] = False
    return repeated


def _steps_cdeg(fields: NDArray[np.void], model: SensorModel | None = None) -> F8:
    """Mean step (n,) from one azimuth reading to the next over each packet.

    It is a mean, because a single reading is off by 0.005 deg: from block to block of a VLP-16 that is 1 part
    in 40. A packet with one reading has the step from the packet before, the first one the step to the next.
    """
    azimuth = fields["blocks"]["azimuth_cdeg"].astype(np.int64)
    reading = readings_in(fields, model)
    turned = (azimuth[:, 1:] - azimuth[:, :-1]) % layout.AZIMUTH_CODES
    # In dual return, blocks 0 and 1, 2 and 3 ... are fired together.
    known = (np.diff(reading, axis=1) == 1) & (turned <= _MAX_STEP_CDEG)
    steps = np.sum(turned * known, axis=1) / np.maximum(np.count_nonzero(known, axis=1), 1)
    alone = reading.max(axis=1, initial=0) == 0
    if alone.any() and len(fields) > 1:
        between = np.diff(azimuth[:, 0]) % layout.AZIMUTH_CODES
        between = np.append(between[:1], between)
        usual = np.median(between)
        steps[alone] = np.where(between > 1.8 * usual, usual, between)[alone]  # packets may be lost
    return steps

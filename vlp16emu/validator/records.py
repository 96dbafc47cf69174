"""Rules about what stands inside each data packet."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlp16emu.packets.decode import PRODUCT_BEFORE_RELEASE
from vlp16emu.packets.layout import (
    AZIMUTH_CODES,
    BLOCK_FLAG,
    FACTORY_BYTE,
    MIN_DISTANCE_LSB,
    RETURN_MODE_BYTE,
)
from vlp16emu.validator.framing import HOUR_US
from vlp16emu.validator.rules import Findings, Level, Rule

_UNEQUAL_REFLECTIVITY_SHARE = 0.05
"""Of the equal pairs of a packet; 603 packets of a real unit show 0.03 % overall and 1.1 % at most."""


@dataclass(frozen=True, slots=True)
class DataChunk:
    """Consecutive data packets of one return mode."""

    number: NDArray[np.int64]
    """(n,) frame numbers."""
    stamp_ns: NDArray[np.int64]
    """(n,) capture stamps."""
    payload: NDArray[np.void]
    """(n,) `DATA_PAYLOAD`."""
    dual: bool
    continues: bool
    """The first packet was the last one of the chunk before, and stands here as its neighbour only."""
    ends: bool
    """No chunk follows that begins with the last packet."""


def check_factory(number: int, factory: bytes, before: bytes, findings: Findings) -> None:
    """Check return mode and product of a packet, where they differ from the packet before.

    Parameters
    ----------
    factory, before : two bytes each; `before` is empty for the first packet
    """
    if factory[0] not in RETURN_MODE_BYTE.values():
        findings.add(Rule.FACTORY, number, f"return mode 0x{factory[0]:02x}", "0x37, 0x38 or 0x39")
    if factory[1] not in FACTORY_BYTE.values():
        # In the first packet it may be that of a unit from before release; a change to it is an error below.
        old = factory[1] == PRODUCT_BEFORE_RELEASE and before[1:] in (b"", factory[1:])
        level = Level.NOTE if old else Level.ERROR
        findings.add(Rule.FACTORY, number, f"product 0x{factory[1]:02x}", "0x22 or 0x24", level)
    if before:
        findings.add(Rule.FACTORY, number, f"bytes {factory.hex(' ')}", f"{before.hex(' ')} as before")


def check_records(chunk: DataChunk, findings: Findings) -> None:
    """Check flags, ranges and codes of each packet, and the pairs of dual return."""
    first = 1 if chunk.continues else 0
    payload, number = chunk.payload[first:], chunk.number[first:]
    _check_ranges(payload, number, findings)
    distance_lsb = np.ascontiguousarray(payload["blocks"]["records"]["distance_lsb"])
    forbidden = (distance_lsb > 0) & (distance_lsb < MIN_DISTANCE_LSB)
    per_packet = forbidden.sum(axis=(1, 2, 3))
    findings.add_where(
        Rule.DISTANCE_CODE,
        per_packet > 0,
        number,
        lambda i: f"{per_packet[i]} distances as short as {distance_lsb[i][forbidden[i]].min()} counts",
        f"0 or at least {MIN_DISTANCE_LSB}",
    )
    if chunk.dual:
        _check_pairs(payload, distance_lsb, number, findings)


def _check_ranges(payload: NDArray[np.void], number: NDArray[np.int64], findings: Findings) -> None:
    """Check flags, azimuths and time stamps that cannot be."""
    flag, azimuth_cdeg = payload["blocks"]["flag"], payload["blocks"]["azimuth_cdeg"]
    timestamp_us: NDArray[np.uint32] = payload["timestamp_us"]
    bad_flag = flag != BLOCK_FLAG

    def found_flag(i: int) -> str:
        block = int(bad_flag[i].argmax())
        return f"{int(flag[i, block]).to_bytes(2, 'little').hex(' ')} at block {block}"

    findings.add_where(Rule.FLAG, np.any(bad_flag, axis=1), number, found_flag, "ff ee")
    most_cdeg = azimuth_cdeg.max(axis=1)
    for wrong, level in ((most_cdeg > AZIMUTH_CODES, Level.ERROR), (most_cdeg == AZIMUTH_CODES, Level.NOTE)):
        findings.add_where(
            Rule.AZIMUTH_RANGE,
            wrong,
            number,
            lambda i: f"azimuth {most_cdeg[i]} at block {azimuth_cdeg[i].argmax()}",
            f"0 .. {AZIMUTH_CODES - 1}",
            level,
        )
    findings.add_where(
        Rule.TIME_RANGE,
        timestamp_us >= HOUR_US,
        number,
        lambda i: f"time stamp {timestamp_us[i]} us",
        f"0 .. {HOUR_US - 1}",
    )


def _check_pairs(
    payload: NDArray[np.void],
    distance_lsb: NDArray[np.uint16],
    number: NDArray[np.int64],
    findings: Findings,
) -> None:
    """Even and odd blocks of dual return. Source: 63-9243 Rev D, section 9.3.2, p. 57."""
    azimuth_cdeg = payload["blocks"]["azimuth_cdeg"]
    twin_differs = azimuth_cdeg[:, ::2] != azimuth_cdeg[:, 1::2]

    def found_azimuths(i: int) -> str:
        even = 2 * int(twin_differs[i].argmax())
        return f"azimuths {azimuth_cdeg[i, even]} and {azimuth_cdeg[i, even + 1]} at blocks {even} and {even + 1}"

    findings.add_where(Rule.DUAL_AZIMUTH, np.any(twin_differs, axis=1), number, found_azimuths, "equal ones")
    last, other = distance_lsb[:, ::2], distance_lsb[:, 1::2]
    swapped = ((last < other) & (last > 0)).sum(axis=(1, 2, 3))
    findings.add_where(
        Rule.DUAL_ORDER,
        swapped > 0,
        number,
        lambda i: f"{swapped[i]} pairs with the last return nearer than the other",
        "the last return to be the farther one",
    )
    reflectivity = np.ascontiguousarray(payload["blocks"]["records"]["reflectivity"])
    equal = last == other
    unequal = (equal & (reflectivity[:, ::2] != reflectivity[:, 1::2])).sum(axis=(1, 2, 3))
    pairs = equal.sum(axis=(1, 2, 3))
    findings.add_where(
        Rule.DUAL_REFLECTIVITY,
        unequal > _UNEQUAL_REFLECTIVITY_SHARE * pairs,
        number,
        lambda i: f"{unequal[i]} of {pairs[i]} pairs of equal distance with unequal reflectivity",
        f"at most {_UNEQUAL_REFLECTIVITY_SHARE:.0%}",
    )

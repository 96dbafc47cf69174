"""Rules about the rotor: it turns, and holds its speed."""

import numpy as np
from numpy.typing import NDArray

from vlp16emu.packets.layout import AZIMUTH_CODES, BLOCK_PERIOD_NS
from vlp16emu.units import S_NS
from vlp16emu.validator.records import DataChunk
from vlp16emu.validator.rules import Findings, Rule

_STILL_CDEG = 12
"""Two readings differ by less than this where the rotor stands; at 300 rpm a packet turns by 220."""
_SET_RPM = 60
"""Speeds that can be set are multiples of this (63-9243 Rev D, section 8.3)."""
_HELD_RPM = 4.0
"""By which the mean of a revolution may be off: speed control, 3 rpm in sibling manuals, and two readings."""


def frozen_packets(chunk: DataChunk, signed_cdeg: NDArray[np.int64], findings: Findings) -> NDArray[np.bool_]:
    """Find packets (n,) in which the rotor stands, and report them.

    Parameters
    ----------
    signed_cdeg : (n, blocks) steps, the last one to the next packet
    """
    still: NDArray[np.bool_] = np.abs(signed_cdeg[:, :-1]).max(axis=1) <= _STILL_CDEG
    still &= np.abs(signed_cdeg[:, :-1].sum(axis=1)) <= _STILL_CDEG
    reported = still.copy()
    reported[0] &= not chunk.continues
    azimuth_cdeg = chunk.payload["blocks"]["azimuth_cdeg"][:, 0]
    findings.add_where(
        Rule.AZIMUTH_STEP,
        reported,
        chunk.number,
        lambda i: f"azimuth frozen at {azimuth_cdeg[i] / 100:.2f} deg",
        "a rotor that turns",
    )
    return still


def check_speed(
    chunk: DataChunk, signed_cdeg: NDArray[np.int64], is_regular: NDArray[np.bool_], findings: Findings
) -> None:
    """Check the mean speed of each revolution, over which the error of the encoder goes out.

    Parameters
    ----------
    signed_cdeg : as of `frozen_packets`
    is_regular : (n - 1,) whether packets follow each other at their period
    """
    turned_cdeg = signed_cdeg[:-1].sum(axis=1)
    middle_cdeg = float(np.median(turned_cdeg)) if len(turned_cdeg) else 0.0
    if middle_cdeg < 1.0:
        return
    packets = max(round(AZIMUTH_CODES / middle_cdeg), 1)
    rows = len(turned_cdeg) // packets * packets
    whole = is_regular[:rows].reshape(-1, packets).all(axis=1)
    revolution_cdeg = turned_cdeg[:rows].reshape(-1, packets).sum(axis=1)
    took_s = packets * signed_cdeg.shape[1] * BLOCK_PERIOD_NS / S_NS
    rpm = revolution_cdeg / AZIMUTH_CODES / took_s * 60.0
    off_rpm = rpm - _SET_RPM * np.rint(rpm / _SET_RPM)
    findings.add_where(
        Rule.SPEED,
        whole & (np.abs(off_rpm) > _HELD_RPM),
        chunk.number[:rows:packets],
        lambda i: f"a revolution at {rpm[i]:.1f} rpm",
        f"a multiple of {_SET_RPM} rpm within {_HELD_RPM:g}, held",
    )

"""Packet blocks of pcapng that follow one another in memory, walked by a kernel."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from vlp16emu.captures.records import Window
from vlp16emu.captures.runs import Run, u4_at
from vlp16emu.kernels.compiler import kernel
from vlp16emu.types import I8, U1
from vlp16emu.units import S_NS

PACKET = 6
"""Block type of the enhanced packet block. Source of all numbers: IETF draft-ietf-opsawg-pcapng."""
LONGEST_BLOCK_BYTES = 16 << 20  # a longer block means damage (MAX_BLOCK_SIZE of Wireshark)
LATEST_NS = 2**32 * S_NS  # stamps of classic pcap reach that far
_HEAD_BYTES = 28  # before the frame
_LEAST_BYTES = 32
_MOST_BLOCKS = 4096  # in a run
_STEPS = 30  # bits of the upper half of a stamp that are multiplied without overflow


class Interface(NamedTuple):
    """An interface of a section."""

    link_type: int
    snap_bytes: int
    units_per_s: int
    offset_s: int
    check_bytes: int  # length of the frame check sequence

    @property
    def unit_ns(self) -> int:
        """Unit of stamps that count from 1970; 0 if it is no whole number, or if they begin elsewhere."""
        return S_NS // self.units_per_s if S_NS % self.units_per_s == 0 and not self.offset_s else 0


def packet_runs(window: Window, order: str, interfaces: Sequence[Interface]) -> Iterator[Run]:
    """Yield the frames of whole packet blocks from the window on, up to another block; move the window.

    Frames of a run have one link type. Interfaces without a whole unit of time end it.
    """
    forms = np.array([(each.link_type, each.unit_ns, each.check_bytes) for each in interfaces], np.int64)
    while True:
        held, begin = window.held()
        columns = np.empty((4, _MOST_BLOCKS), np.int64)
        content = np.frombuffer(held, np.uint8)
        count, end, link_type = _packet_blocks(content, begin, order == ">", forms, columns)
        if count:
            yield Run(link_type, held, *columns[:, :count])
            window.skip(end - begin)
        elif not window.grow():
            return


@kernel
def _packet_blocks(
    content: U1, begin: int, is_big_endian: bool, forms: I8, columns: I8
) -> tuple[int, int, int]:
    """Walk over packet blocks, and write the columns of `Run` (4, m).

    Parameters
    ----------
    forms : link type, unit of time and length of the frame check sequence (k, 3) of the interfaces

    Returns
    -------
    number of blocks, offset after the last one, link type
    """
    at = np.int64(begin)
    count = 0
    link_type = np.int64(0)
    while at + _LEAST_BYTES <= len(content) and count < columns.shape[1]:
        size = u4_at(content, at + 4, is_big_endian)
        interface = u4_at(content, at + 8, is_big_endian)
        if u4_at(content, at, is_big_endian) != PACKET or interface >= len(forms):
            break
        if not _LEAST_BYTES <= size <= LONGEST_BLOCK_BYTES or size % 4 or at + size > len(content):
            break
        if u4_at(content, at + size - 4, is_big_endian) != size:
            break
        unit_ns = forms[interface, 1]
        high = u4_at(content, at + 12, is_big_endian)
        units = (high << 32) | u4_at(content, at + 16, is_big_endian)
        if unit_ns == 0 or high >> _STEPS or units > LATEST_NS // unit_ns:
            break
        if count and link_type != forms[interface, 0]:
            break
        link_type = forms[interface, 0]
        wire_bytes = u4_at(content, at + 24, is_big_endian) - forms[interface, 2]
        if wire_bytes < 0:
            wire_bytes = np.int64(0)
        captured = min(u4_at(content, at + 20, is_big_endian), size - _HEAD_BYTES)
        columns[0, count] = at + _HEAD_BYTES
        columns[1, count] = min(captured, wire_bytes)
        columns[2, count] = wire_bytes
        columns[3, count] = units * unit_ns
        count += 1
        at += size
    return count, int(at), int(link_type)

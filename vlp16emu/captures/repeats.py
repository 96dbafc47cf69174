"""Repeated packets of a capture, found among the latest ones of all senders."""

from collections import deque
from itertools import compress
from typing import TYPE_CHECKING

import numpy as np

from vlp16emu.captures.runs import DATA_STAMP_AT, POSITION_STAMP_AT
from vlp16emu.packets.layout import BLOCK_FLAG, DATA_BYTES, POSITION_BYTES
from vlp16emu.types import I8

if TYPE_CHECKING:
    from vlp16emu.captures.datagrams import Datagram, PlainBatch

_RECENT = 512
"""Packets among which a repeat is found: 0.7 s of one sensor. Bridges, bonds and `-i any` repeat within
milliseconds."""
_FLAG = BLOCK_FLAG.to_bytes(2, "little")


class Repeats:
    """The latest packets, and whether another one repeats one of them.

    A packet is a repeat if its sender has just sent the same payload to that port. Time stamps make payloads
    unique.
    """

    def __init__(self) -> None:
        self._latest = deque["Datagram"](maxlen=_RECENT)
        self._batches = deque["PlainBatch"]()
        """Later packets than those: the latest batches, whose datagrams are not made yet."""
        # Each is made from the latest packets where it is None.
        self._known: set[_Identity] | None = None
        self._keys: I8 | None = None

    def take_new(self, batch: "PlainBatch") -> bool:
        """Take packets if their keys show that none is a repeat; return whether they were taken."""
        if self._keys is None:
            self._keys = np.array([_key_of(datagram) for datagram in self._latest], np.int64)
        key = batch.columns.key
        keys = np.concatenate([self._keys, key[key != 0]])
        ordered = np.sort(keys)
        if (ordered[1:] == ordered[:-1]).any():
            return False
        self._keys = keys[-_RECENT:]
        self._batches.append(batch)
        later = sum(np.count_nonzero(each.columns.key) for each in self._batches)
        while later - np.count_nonzero(self._batches[0].columns.key) >= _RECENT:
            later -= np.count_nonzero(self._batches.popleft().columns.key)
        self._known = None
        return True

    def _make_latest(self) -> None:
        """Make the datagrams of the batches."""
        for batch in self._batches:
            self._latest.extend(compress(batch.datagrams(), batch.columns.key.tolist()))
        self._batches.clear()

    def take(self, datagram: "Datagram") -> bool:
        """Take a packet, and return whether it is a repeat; what is no packet of a sensor is none."""
        payload = datagram.payload
        is_data = len(payload) == DATA_BYTES and payload.startswith(_FLAG)
        if not is_data and len(payload) != POSITION_BYTES:
            return False
        if self._known is None:
            self._make_latest()
            self._known = {_identity(each) for each in self._latest}
        identity = _identity(datagram)
        if identity in self._known:
            return True
        if len(self._latest) == _RECENT:  # bounds the memory for long captures
            self._known.discard(_identity(self._latest[0]))
        self._known.add(identity)
        self._latest.append(datagram)
        self._keys = None
        return False


_Identity = tuple[bytes, int, bytes]


def _identity(datagram: "Datagram") -> _Identity:
    return datagram.source, datagram.destination_port, datagram.payload


def _key_of(datagram: "Datagram") -> int:
    """Return the key of a packet, as in `PlainDatagrams`."""
    payload = datagram.payload
    at = DATA_STAMP_AT if len(payload) == DATA_BYTES else POSITION_STAMP_AT
    stamp = int.from_bytes(payload[at : at + 4], "little")
    address = int.from_bytes(datagram.source[-4:])
    return (address << 20) ^ (datagram.destination_port << 33) ^ stamp | 1 << 62

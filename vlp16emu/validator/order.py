"""Rules about the order of packets: none comes twice, none after its successor."""

from collections.abc import Iterator
from enum import StrEnum

import numpy as np

from vlp16emu.packets.capture import Datagram
from vlp16emu.packets.layout import (
    DATA_PAYLOAD,
    POSITION_PAYLOAD,
    RETURN_MODE_BYTE,
    SEQUENCES_PER_PACKET,
)
from vlp16emu.sensor.beams import SEQUENCE_NS
from vlp16emu.types import PacketKind, ReturnMode
from vlp16emu.units import US_NS
from vlp16emu.validator.framing import wrap_hour_us
from vlp16emu.validator.rules import Findings, Rule

_HELD = 128
"""Packets among which one is put in its place: those of 0.17 s in single return."""
_LAYOUTS = {PacketKind.DATA: DATA_PAYLOAD, PacketKind.POSITION: POSITION_PAYLOAD}
_MODE_AT: int = DATA_PAYLOAD.fields["return_mode"][1]  # type: ignore[index]  # it has fields
_PERIODS_NS = {
    RETURN_MODE_BYTE[mode]: sequences * SEQUENCE_NS for mode, sequences in SEQUENCES_PER_PACKET.items()
}
assert set(ReturnMode) == set(SEQUENCES_PER_PACKET)


class _Place(StrEnum):
    """Where a packet belongs beside the newest."""

    NEXT = "next"
    AGAIN = "again"
    BEFORE = "before"


class InOrder:
    """Brings the packets of one kind into the order in which they were made, and leaves out those that come again.

    What does not fit the packets held, because the clock has been set or a stamp is wrong, stays where it is.
    """

    def __init__(self, kind: PacketKind, findings: Findings) -> None:
        self._kind, self._findings = kind, findings
        layout = _LAYOUTS[kind]
        self._stamp_at = int(np.dtype(layout).fields["timestamp_us"][1])  # type: ignore[index]
        self._held: list[Datagram] = []
        self._repeats = 0

    def take(self, datagram: Datagram) -> Iterator[Datagram]:
        """Put a packet in its place, and yield those whose turn has come."""
        place = self._place(datagram)
        self._repeats = self._repeats + 1 if place is _Place.AGAIN else 0
        if place is _Place.AGAIN:
            return
        if place is _Place.BEFORE:
            self._insert(datagram)
        elif self._held and self._ahead_us(datagram) < 0:
            yield from self.rest()
            self._held.append(datagram)
        else:
            self._held.append(datagram)
        if len(self._held) > _HELD:
            yield self._held.pop(0)

    def rest(self) -> Iterator[Datagram]:
        """Yield those that are still held."""
        held, self._held = self._held, []
        yield from held

    def _place(self, datagram: Datagram) -> _Place:
        """Find where a packet belongs, and report where that is not behind the newest."""
        for known in reversed(self._held):
            if datagram.payload == known.payload:
                self._report_again(datagram, known)
                return _Place.AGAIN
            if self._stamp_us(known) <= self._stamp_us(datagram):
                break
        if self._held and self._ahead_us(datagram) < 0 and self._is_late(datagram):
            return _Place.BEFORE
        return _Place.NEXT

    def _report_again(self, datagram: Datagram, known: Datagram) -> None:
        """Report a packet that was there already; a sensor that hangs sends it again and again."""
        frozen = self._repeats > 0 or (
            self._kind is PacketKind.POSITION and datagram.identification != known.identification
        )
        rule = Rule.FROZEN if frozen else Rule.DUPLICATE
        found = (
            f"the payload of packet {known.number} again and again"
            if frozen
            else f"packet {known.number} again"
        )
        self._findings.add(rule, datagram.number, found, f"a new {self._kind} packet")

    def _insert(self, datagram: Datagram) -> None:
        """Put a late packet in its place, and report it."""
        place = len(self._held)
        while place and wrap_hour_us(self._stamp_us(datagram) - self._stamp_us(self._held[place - 1])) < 0:
            place -= 1
        found = f"a {self._kind} packet overtaken by {len(self._held) - place}"
        self._findings.add(Rule.PACKET_ORDER, datagram.number, found, "packets in order of their time stamps")
        self._held.insert(place, datagram)

    def _is_late(self, datagram: Datagram) -> bool:
        """Whether it belongs between those that are held: by the period of data packets, or the count of position packets."""
        if wrap_hour_us(self._stamp_us(datagram) - self._stamp_us(self._held[0])) <= 0:
            return False
        if self._kind is PacketKind.POSITION:
            return 0 < (self._held[-1].identification - datagram.identification) % 0x10000 <= _HELD
        period_ns = _PERIODS_NS.get(datagram.payload[_MODE_AT])
        if period_ns is None:
            return False
        behind_ns = -self._ahead_us(datagram) * US_NS
        return abs(behind_ns - round(behind_ns / period_ns) * period_ns) <= 2 * US_NS

    def _ahead_us(self, datagram: Datagram) -> int:
        return wrap_hour_us(self._stamp_us(datagram) - self._stamp_us(self._held[-1]))

    def _stamp_us(self, datagram: Datagram) -> int:
        return int.from_bytes(datagram.payload[self._stamp_at : self._stamp_at + 4], "little")

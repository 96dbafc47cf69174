"""The base of what changes, accompanies or watches a stream. It loads no library, as help must be quick."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from vlp16emu.sinks import PacketSink
    from vlp16emu.types import Packet, PacketKind


class StreamPart:
    """A part of a stream, which changes, accompanies or watches its packets; override what it needs.

    Methods are called by the thread of the stream, of all parts in their order: those of the stream
    first, then those that were added, which see packets as they are sent. `end` is called in the reverse
    order when no more packets leave.
    """

    @property
    def result(self) -> object:
        """What the part reports once it has ended."""
        return None

    def begin(self) -> None:
        """Get ready for packets, before the first one is computed."""

    def ready(self) -> None:
        """Begin beside the first packet, which is computed; the clock starts afterwards."""

    def leaving(self, packet: "Packet") -> "Packet":
        """Return a packet as it is sent next."""
        return packet

    def sent(self, packet: "Packet") -> None:
        """Take note of a packet that has just been sent."""

    def news(self, line: str) -> None:
        """Take note of a line for people, such as that the stream falls behind; from any thread."""

    def end(self, error: BaseException | None) -> None:
        """End; `error` is what ended the stream before its time."""


class OutletPart(StreamPart):
    """A part that sends packets of further kinds, to sinks of its own."""

    kinds: "Sequence[PacketKind]"
    """Kinds of packets that the engine shall make beside those of the sensors."""
    sinks: "Mapping[PacketKind, PacketSink]"
    """Sink of each kind."""
    look_ahead: int
    """Packets that a stream computes further ahead because of them."""

    @property
    def result(self) -> "Mapping[PacketKind, object]":
        """What was sent of each kind."""
        raise NotImplementedError


class PosePart(StreamPart):
    """A part that moves the carrier of a live scene by poses that come in."""

    look_ahead: int
    """Packets of a sensor that are computed before they are due."""
    lead_ns: int
    """Time before its first pulse at which the engine goes on after it fell behind."""


class WebPart(StreamPart):
    """A part that serves the web interfaces of the sensors."""

    places: Sequence[tuple[str, int]]
    """Host and port of each interface; none before the first packet is ready."""

    def happen(self, kind: str, unit: int = 1, **keys: object) -> int:
        """Add an event of a unit, from 1, a moment from now, and return its UTC in ns."""
        raise NotImplementedError

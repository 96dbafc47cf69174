"""The base of what changes, accompanies or watches a stream. It loads no library, as help must be quick."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from vlp16emu.types import Packet


class StreamPart:
    """A part of a stream, which changes, accompanies or watches its packets; override what it needs.

    Methods are called by the thread of the stream, of all parts in their order: those of the stream
    first, then those that were added, which see packets as they are sent. `end` is called in the reverse
    order when no more packets leave.
    """

    result: Any = None  # what the part reports once it has ended

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

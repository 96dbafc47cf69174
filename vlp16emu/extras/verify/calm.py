"""Runs of packets that are checked together: nearly all of a sound capture.

Steps of clocks, order and lengths are computed for all packets of a run at once. Packets that break a rule of
order, clocks, ports or lengths, or may break one, are checked one by one.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlp16emu.captures.datagrams import Datagram
from vlp16emu.extras.verify.frames import PAYLOAD_BYTES, PORT, STAMP_AT
from vlp16emu.types import I8, PacketKind

LONGEST = 256  # packets of a run: 0.3 s of single return


class CalmRun(NamedTuple):
    """Packets of one unit from the usual ports, with whole payloads, in the order of the capture."""

    datagrams: Sequence[Datagram]
    is_data: NDArray[np.bool_]  # (n,) others are position packets
    host_ns: I8  # (n,) capture stamps
    stamp_us: I8  # (n,) time stamps

    def part(self, first: int, stop: int) -> "CalmRun":
        """Return the packets from `first` on and before `stop`."""
        return CalmRun(*(column[first:stop] for column in self))  # type: ignore[arg-type]

    def of(self, kind: PacketKind) -> "CalmRun":
        """Return the packets of a kind."""
        chosen = self.is_data == (kind is PacketKind.DATA)
        places = np.flatnonzero(chosen).tolist()
        datagrams = [self.datagrams[place] for place in places]
        return CalmRun(datagrams, self.is_data[chosen], self.host_ns[chosen], self.stamp_us[chosen])


_KINDS = {(PORT[kind], PAYLOAD_BYTES[kind]): kind for kind in PORT}


def calm_run(datagrams: Sequence[Datagram]) -> CalmRun | None:
    """Return one or more packets as a run; None if a port or a length is not the usual one."""
    found = [_KINDS.get((each.source_port, len(each.payload))) for each in datagrams]
    if None in found:
        return None
    is_data = np.array([kind is PacketKind.DATA for kind in found])
    host_ns = np.array([each.stamp_ns for each in datagrams], np.int64)
    stamps = [
        each.payload[STAMP_AT[kind] : STAMP_AT[kind] + 4]
        for each, kind in zip(datagrams, found, strict=True)
        if kind is not None
    ]
    return CalmRun(datagrams, is_data, host_ns, np.frombuffer(b"".join(stamps), "<u4").astype(np.int64))

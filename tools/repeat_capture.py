#!/usr/bin/env python3
"""Write a capture of one VLP-16 several times in a row, each time later by whole seconds.

    tools/repeat_capture.py CAPTURE OUT PASSES SECONDS

CAPTURE is a classic pcap as `vlp16emu record` writes it, with whole packets. Stamps of records and of
packets, and the sentences of the receiver, are shifted.
"""

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vlp16emu.captures import Capture
from vlp16emu.extras.bench.retime import shift_packet
from vlp16emu.packets import DATA_BYTES, DATA_PAYLOAD, POSITION_BYTES
from vlp16emu.types import Packet, PacketKind

_PCAP_HEADER, _RECORD_HEADER, _HEADERS = 24, 16, 42
"""Bytes of the headers of a classic pcap, of its records, and of Ethernet, IPv4 and UDP."""
_HOUR_US = 3600 * 10**6


def repeat_capture(capture: Path, out: Path, passes: int, seconds: int) -> None:
    """Write the capture; each pass is later by `seconds`."""
    raw = np.fromfile(capture, np.uint8)
    starts = [_PCAP_HEADER]  # of the records
    positions = list[tuple[int, Packet]]()
    for datagram in Capture(capture, repeats=True):
        at = starts[-1]
        if len(datagram.payload) == POSITION_BYTES:
            packet = Packet(PacketKind.POSITION, datagram.stamp_ns, datagram.payload)
            positions.append((at + _RECORD_HEADER + len(datagram.header), packet))
        starts.append(at + _RECORD_HEADER + datagram.captured_bytes)
    begin = np.array(starts[:-1])
    is_data = np.diff(starts) == _RECORD_HEADER + _HEADERS + DATA_BYTES
    stamp_at = begin[is_data] + _RECORD_HEADER + _HEADERS + DATA_PAYLOAD.fields["timestamp_us"][1]
    second = _words(raw, begin)
    timestamp_us = _words(raw, stamp_at)
    with out.open("wb") as file:
        file.write(raw[:_PCAP_HEADER].tobytes())
        for later_s in range(0, passes * seconds, seconds):
            _set_words(raw, begin, second + later_s)
            _set_words(raw, stamp_at, (timestamp_us + 10**6 * later_s) % _HOUR_US)
            for at, packet in positions:
                raw[at : at + POSITION_BYTES] = np.frombuffer(shift_packet(packet, later_s).payload, np.uint8)
            file.write(raw[_PCAP_HEADER:].tobytes())


def _words(raw: NDArray[np.uint8], at: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the little-endian words of four bytes at some places."""
    return np.asarray(raw[at[:, None] + np.arange(4)] @ (1 << 8 * np.arange(4)))


def _set_words(raw: NDArray[np.uint8], at: NDArray[np.int64], words: NDArray[np.int64]) -> None:
    raw[at[:, None] + np.arange(4)] = words[:, None] >> 8 * np.arange(4) & 255


def main() -> None:
    """Read the command line, and write the capture."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("capture", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("passes", type=int)
    parser.add_argument("seconds", type=float, help="length of the capture, at least a second")
    wanted = parser.parse_args()
    repeat_capture(wanted.capture, wanted.out, wanted.passes, max(round(wanted.seconds), 1))


if __name__ == "__main__":
    main()

"""Captures in their files, for `tools/unmask` and `tools/unit_laws`."""

from pathlib import Path

from vlp16emu.packets.layout import DATA_BYTES
from vlp16emu.sinks import PcapSink
from vlp16emu.types import Packet, PacketKind

PACKET_NS = 1_327_104


def framed(path: Path, folder: Path) -> Path:
    """Return a capture; concatenated payloads get frames, evenly spaced unless a file has arrival times."""
    if path.suffix != ".bin":
        return path
    out, payloads, beside = (
        folder / f"{path.stem}.pcap",
        path.read_bytes(),
        path.with_suffix(".stamps_ns.txt"),
    )
    count = len(payloads) // DATA_BYTES
    stamps_ns = (
        [*map(int, beside.read_text().split())] if beside.exists() else range(0, PACKET_NS * count, PACKET_NS)
    )
    with PcapSink(out) as sink:
        for i, stamp_ns in zip(range(count), stamps_ns, strict=True):
            sink.send(Packet(PacketKind.DATA, stamp_ns, payloads[DATA_BYTES * i : DATA_BYTES * (i + 1)]))
    return out

"""Sinks of packets: a capture file, the network, or a list; and the clock that lets packets leave in time."""

from vlp16emu.sinks.pacing import TOLERANCE_NS, FellBehind, Late, Lateness, LatenessHistogram, Pacer
from vlp16emu.sinks.pcap import PcapResult, PcapSink, check_ending
from vlp16emu.sinks.sink import Away, MemorySink, Outlet, OutletResult, PacketSink, SinkByKind
from vlp16emu.sinks.stream import LOOK_AHEAD_PACKETS, FirstPacket, NowSink, StreamReport, UnderWay, stream
from vlp16emu.sinks.udp import LOOPBACK, RigSink, UdpResult, UdpSink, free_ports

__all__ = [
    "LOOK_AHEAD_PACKETS",
    "LOOPBACK",
    "TOLERANCE_NS",
    "Away",
    "FellBehind",
    "FirstPacket",
    "Late",
    "Lateness",
    "LatenessHistogram",
    "MemorySink",
    "NowSink",
    "Outlet",
    "OutletResult",
    "Pacer",
    "PacketSink",
    "PcapResult",
    "PcapSink",
    "RigSink",
    "SinkByKind",
    "StreamReport",
    "UdpResult",
    "UdpSink",
    "UnderWay",
    "check_ending",
    "free_ports",
    "stream",
]

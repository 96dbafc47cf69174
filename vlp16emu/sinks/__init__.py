"""Where packets leave: a capture file, the network, or a list; and the clock that lets them leave in time."""

from vlp16emu.sinks.pacing import TOLERANCE_NS, FellBehind, Late, Lateness, LatenessHistogram, Pacer
from vlp16emu.sinks.pcap import PcapResult, PcapSink, check_ending
from vlp16emu.sinks.readiness import Check, Condition, sending_checks
from vlp16emu.sinks.sink import Away, MemorySink, Outlet, OutletResult, PacketSink, SinkByKind
from vlp16emu.sinks.stream import (
    LOOK_AHEAD_PACKETS,
    FirstPacket,
    NowSink,
    StreamReport,
    UnderWay,
    sending_share,
    stream,
)
from vlp16emu.sinks.udp import LOOPBACK, RigSink, UdpResult, UdpSink

__all__ = [
    "LOOK_AHEAD_PACKETS",
    "LOOPBACK",
    "TOLERANCE_NS",
    "Away",
    "Check",
    "Condition",
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
    "sending_checks",
    "sending_share",
    "stream",
]

"""Where packets leave: a capture file, the network, or a list; and the clock that lets them leave in time."""

from vlp16emu.sinks.delay import TOLERANCE_NS, FellBehind, Late
from vlp16emu.sinks.memory import MemorySink
from vlp16emu.sinks.pacing import Lateness, LatenessHistogram, Pacer
from vlp16emu.sinks.pcap import STDOUT, PcapResult, PcapSink
from vlp16emu.sinks.rig import RigSink
from vlp16emu.sinks.sending_cost import sending_share
from vlp16emu.sinks.sink import PacketSink
from vlp16emu.sinks.stream import LOOK_AHEAD_PACKETS, StreamReport, stream
from vlp16emu.sinks.truth import TruthFolder, TruthTo, tum_rows
from vlp16emu.sinks.udp import LOOPBACK, UdpResult, UdpSink

__all__ = [
    "LOOK_AHEAD_PACKETS",
    "LOOPBACK",
    "STDOUT",
    "TOLERANCE_NS",
    "FellBehind",
    "Late",
    "Lateness",
    "LatenessHistogram",
    "MemorySink",
    "Pacer",
    "PacketSink",
    "PcapResult",
    "PcapSink",
    "RigSink",
    "StreamReport",
    "TruthFolder",
    "TruthTo",
    "UdpResult",
    "UdpSink",
    "sending_share",
    "stream",
    "tum_rows",
]

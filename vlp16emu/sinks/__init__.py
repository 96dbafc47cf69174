"""Sinks of packets, a capture file and the network, and the pacing of packets."""

from vlp16emu.sinks.pacing import TOLERANCE_NS, FellBehind, Late, Lateness, LatenessHistogram, Pacer
from vlp16emu.sinks.pcap import PcapResult, PcapSink, check_ending
from vlp16emu.sinks.stream import LOOK_AHEAD_PACKETS, StreamReport, UnderWay, stream
from vlp16emu.sinks.udp import LOOPBACK, UdpSink
from vlp16emu.types import PacketSink

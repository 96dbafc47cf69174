"""Sinks of packets, a capture file and the network, and the pacing of packets."""

from vlp16emu.sinks.look_ahead import LOOK_AHEAD_PACKETS, LookAhead
from vlp16emu.sinks.pacing import TOLERANCE_NS, FellBehind, Late, Lateness, LatenessHistogram, Pacer
from vlp16emu.sinks.pcap import PcapResult, PcapSink, check_ending
from vlp16emu.sinks.udp import UdpSink
from vlp16emu.types import PacketSink

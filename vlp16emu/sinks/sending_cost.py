"""What sending in real time takes of a core."""

import socket
import time
from collections.abc import Sequence

from vlp16emu.sinks.pacing import Pacer
from vlp16emu.sinks.stream import stream
from vlp16emu.sinks.udp import LOOPBACK, UdpSink
from vlp16emu.types import Packet

__all__ = ["sending_share"]


def sending_share(packets: Sequence[Packet]) -> float:
    """Processor seconds per second of the thread that sends packets in real time, measured by doing so.

    They go to a socket of this process that nobody reads, so no other program is sent anything.

    Parameters
    ----------
    packets : in order of sending
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind((LOOPBACK, 0))
        port = receiver.getsockname()[1]
        with UdpSink(data_port=port, position_port=port) as sink:
            before_s = time.thread_time()
            report = stream(packets, sink, Pacer(1.0))
            took_s = time.thread_time() - before_s
    return took_s / report.simulated_s if report.simulated_s > 0 else 0.0

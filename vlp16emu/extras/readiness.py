"""Checks of whether this machine can send as a sensor does (ports, rights, clock, wake-ups, buffers), and the cost of sending."""

import socket
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

import numpy as np

from vlp16emu.packets.frames import DATA_PORT, FACTORY_LINK, POSITION_PORT
from vlp16emu.sinks import LOOPBACK, TOLERANCE_NS, Pacer, UdpSink, stream
from vlp16emu.sinks.pacing import prompt
from vlp16emu.types import Packet

_SLEEPS = 200
_SLEEP_S = 0.001_327
"""As long as between two data packets in single return (VLP-16 manual 63-9243 Rev D, section 8.2)."""
_PROMPT_NS = 1_327_104
"""A packet that is later than that leaves after the next one is due."""
_COARSE_S = 1e-6
_PAUSE_S = 0.1
"""A revolution at 600 rpm: pauses of receivers that share their cores are shorter."""
_RIG_PACKETS_HZ = 2 * 1508
"""Data packets of two sensors in dual return (63-9243 Rev D, section 8.2)."""
_HELD_BYTES = 2304
"""That Linux counts for one of them in a receive buffer: payload, headers and its own record, rounded up."""


class Condition(StrEnum):
    """Outcome of a check."""

    OK = "ok"
    WARNING = "warning"
    """Some runs will suffer."""
    PROBLEM = "problem"
    """Some runs will fail."""


@dataclass(frozen=True, slots=True)
class Check:
    """One thing that was looked at."""

    name: str
    finding: Condition
    found: str
    mend: str = ""
    """A command or a line; empty where nothing is to be done."""


def sending_checks() -> Iterator[Check]:
    """Look at all that sending needs; takes half a second."""
    for name, port in (("data port", DATA_PORT), ("position port", POSITION_PORT)):
        yield _port(name, port)
    yield _address(FACTORY_LINK.source)
    yield _interface_right()
    yield _clock()
    yield _wake_ups()
    yield _buffer()


def _bound(address: str, port: int) -> str:
    """Say why an address cannot be sent from; empty where it can."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((address, port))
        except OSError as error:
            return str(error.strerror)
    return ""


def _port(name: str, port: int) -> Check:
    if not (reason := _bound("", port)):
        return Check(name, Condition.OK, f"{port} is free")
    mend = f"right for a receiver here; --as-sensor needs it: ss -ulpn 'sport = :{port}' shows its program"
    return Check(name, Condition.WARNING, f"{port}: {reason}", mend)


def _address(address: str) -> Check:
    if not _bound(address, 0):
        return Check("sensor address", Condition.OK, f"{address} is this machine's")
    mend = f"for --as-sensor: sudo ip addr add {address}/24 dev IFACE"
    return Check("sensor address", Condition.OK, f"{address} is not this machine's", mend)


def _interface_right() -> Check:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, b"lo")
        except (OSError, AttributeError) as error:
            mend = "for --interface: Linux 5.7, or sudo setcap cap_net_raw+ep on the Python that runs this"
            return Check("interface right", Condition.WARNING, f"--interface is refused: {error}", mend)
    return Check("interface right", Condition.OK, "sockets can be bound to an interface")


def _clock() -> Check:
    resolution_s = time.get_clock_info("monotonic").resolution
    found = f"{resolution_s * 1e9:.0f} ns"
    if resolution_s <= _COARSE_S:
        return Check("clock resolution", Condition.OK, found)
    return Check("clock resolution", Condition.WARNING, found, "a kernel with high-resolution timers")


def _wake_ups() -> Check:
    """Measure how late sleeps end, as streams sleep."""
    late_ns = []
    with prompt():
        for _ in range(_SLEEPS):
            until_ns = time.monotonic_ns() + round(_SLEEP_S * 1e9)
            time.sleep(_SLEEP_S)
            late_ns.append(time.monotonic_ns() - until_ns)
    median_ns, p99_ns = np.quantile(late_ns, [0.5, 0.99])
    found = f"median {median_ns * 1e-3:.0f} us, 99 % within {p99_ns * 1e-3:.0f} us late"
    mend = "fewer programs at once, or a smaller --threads, so that a core is left to the thread that sends"
    if p99_ns <= _PROMPT_NS:
        return Check("wake-ups", Condition.OK, found)
    return Check("wake-ups", Condition.WARNING if p99_ns <= TOLERANCE_NS else Condition.PROBLEM, found, mend)


def _buffer() -> Check:
    """Return whether a receiver here may have a buffer that holds two sensors in dual return for a revolution."""
    needed = round(_PAUSE_S * _RIG_PACKETS_HZ * _HELD_BYTES)
    name, key = "receive buffer", "net.core.rmem_max"
    try:
        most = int(Path("/proc/sys/net/core/rmem_max").read_text(encoding="ascii"))
    except (OSError, ValueError):
        return Check(name, Condition.OK, "not reported by this system")
    found = f"{key} is {most}; two sensors in dual return fill {needed} in {_PAUSE_S:g} s"
    # Linux doubles what SO_RCVBUF asks for (socket(7)).
    if 2 * most >= needed:
        return Check(name, Condition.OK, found)
    mend = f"sudo sysctl -w {key}={needed}, and SO_RCVBUF in the receiver"
    return Check(name, Condition.WARNING, found, mend)


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
        with UdpSink([replace(FACTORY_LINK, data_port=port, position_port=port)]) as sink:
            before_s = time.thread_time()
            report = stream(packets, sink, Pacer(1.0))
            took_s = time.thread_time() - before_s
    return took_s / report.simulated_s if report.simulated_s > 0 else 0.0

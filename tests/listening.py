"""Receivers on free ports of the loopback, and of sentences."""

import contextlib
import socket
import threading
import time

import pynmea2

from vlp16emu.packets.nmea import KNOT_M_S, utc_ns
from vlp16emu.sinks import PacketSink
from vlp16emu.types import GnssFix

SO_RCVBUFFORCE = 33  # source: asm-generic/socket.h


class MemorySink(PacketSink):
    """Keeps the packets that it is sent."""

    def __init__(self):
        self.packets = []

    def send(self, packet):
        """Keep one packet."""
        self.packets.append(packet)


def parse_rmc(sentence):
    """Fix of a sentence, as pynmea2 reads it."""
    said = pynmea2.parse(sentence.decode("ascii"), check=True)
    t_ns, speed_m_s = utc_ns(said.data[8], said.data[0]), said.spd_over_grnd * KNOT_M_S
    return GnssFix(t_ns, said.is_valid, said.latitude, said.longitude, speed_m_s, said.true_course)


def opened(timeout_s=30.0):
    """UDP socket on a free port, with room for seconds of packets."""
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
    with contextlib.suppress(PermissionError):  # else a busy machine loses what does not fit
        receiver.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 1 << 23)
    receiver.bind(("127.0.0.1", 0))
    receiver.settimeout(timeout_s)
    return receiver


def port_of(receiver):
    return receiver.getsockname()[1]


def waiting(receiver):
    """All payloads that have arrived, at once."""
    payloads, before_s = [], receiver.gettimeout()
    receiver.settimeout(0)
    with contextlib.suppress(BlockingIOError):
        while True:
            payloads.append(receiver.recv(2048))
    receiver.settimeout(before_s)
    return payloads


class Listener(threading.Thread):
    """Takes what comes to a free port of the loopback, until `end`."""

    def __init__(self):
        super().__init__(daemon=True)
        self.socket, self.payloads, self.came = opened(None), [], threading.Event()
        self.port = port_of(self.socket)
        self.start()

    def run(self):
        """Take payloads until an empty one comes."""
        with self.socket:
            for payload in iter(lambda: self.socket.recv(2048), b""):
                self.payloads.append(payload)
                self.came.set()

    def wait_for(self, wanted, timeout_s=120.0):
        """Wait until a payload that comes from now on is wanted; whether one has come in time."""
        until_s = time.monotonic() + timeout_s
        seen = len(self.payloads)
        while time.monotonic() < until_s:
            self.came.clear()
            if any(map(wanted, self.payloads[seen:])):
                return True
            seen = max(len(self.payloads) - 1, seen)
            self.came.wait(1.0)
        return False

    def end(self):
        """Give all payloads that were sent before."""
        if self.is_alive():
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as last:
                last.sendto(b"", ("127.0.0.1", self.port))
        self.join()
        return self.payloads

"""Broadcast of our sockets in a private network of Linux."""

import os
import shutil
import subprocess
import sys

import pytest

IN_NAMESPACE = """
import array, fcntl, socket, struct, subprocess
from vlp16emu.errors import OutputError
from vlp16emu.sinks import UdpSink
from vlp16emu.types import Packet, PacketKind

def ip(words):
    subprocess.run(["ip", *words.split()], check=True)

try:
    UdpSink(host="255.255.255.255")
except OutputError as error:
    print(error)
ip("link add sensor0 type veth peer name host0")
ip("addr add 192.168.1.201/24 dev sensor0")
ip("link set sensor0 up")
ip("link set host0 up")
# Checksums are left to a network card by default, and there is none here: SIOCETHTOOL, ETHTOOL_STXCSUM 0.
value = array.array("I", [0x17, 0])
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
    fcntl.ioctl(control, 0x8946, struct.pack("16sP", b"sensor0", value.buffer_info()[0]))
wire = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(0x0800))
wire.bind(("host0", 0x0800))
wire.settimeout(5)
with UdpSink(host="192.168.1.255", as_sensor=True) as sink:
    for kind, size in ((PacketKind.DATA, 1206), (PacketKind.POSITION, 512)):
        sink.send(Packet(kind, 0, bytes(size)))
        print(wire.recv(2000).hex())
"""

pytestmark = [
    pytest.mark.skipif(os.geteuid() != 0, reason="a private network needs root"),
    pytest.mark.skipif(
        not (shutil.which("ip") and shutil.which("unshare")), reason="needs iproute2 and unshare"
    ),
]


@pytest.fixture(scope="module")
def printed():
    """Lines that the program printed in a network of its own, which is gone afterwards."""
    if subprocess.run(["unshare", "--net", "true"], capture_output=True, check=False).returncode:
        pytest.skip("this machine allows no private network")
    command = ["unshare", "--net", sys.executable, "-c", IN_NAMESPACE]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_broadcast_without_a_route_is_refused(printed):
    """Where no interface leads to the destination the sink says so before anything is computed."""
    assert printed[0] == "destination 255.255.255.255: Network is unreachable; expected an address in reach"


def test_broadcast_to_the_subnet_is_recognised(printed):
    """An address that is a broadcast address only by its netmask is sent to all stations too."""
    frames = [bytes.fromhex(line) for line in printed[1:]]
    assert [len(frame) for frame in frames] == [1248, 554]
    assert {frame[:6] for frame in frames} == {b"\xff" * 6}
    assert {frame[30:34] for frame in frames} == {bytes([192, 168, 1, 255])}

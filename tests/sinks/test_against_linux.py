"""Frames that Linux makes of our sockets, in a private network, against those of a real sensor."""

import os
import shutil
import subprocess
import sys

import pytest

from vlp16emu.packets.frames import FACTORY_LINK, data_header, position_frame

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
for target in ("255.255.255.255", "192.168.1.255"):
    with UdpSink(host=target, as_sensor=True) as sink:
        for i in range(4):
            sink.send(Packet(PacketKind.DATA, 0, bytes([i]) * 1206))
            sink.send(Packet(PacketKind.POSITION, 0, bytes([i]) * 512))
        for _ in range(8):
            print(wire.recv(2000).hex())
"""

pytestmark = [
    pytest.mark.skipif(os.geteuid() != 0, reason="a private network needs root"),
    pytest.mark.skipif(not (shutil.which("ip") and shutil.which("unshare")), reason="needs iproute2 and unshare"),
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


def test_frames_to_the_broadcast_address_are_those_of_a_sensor(printed):
    """From byte 12 on, data and position frames are the real ones, header and payload."""
    frames = [bytes.fromhex(line) for line in printed[1:9]]
    for i, (data, position) in enumerate(zip(frames[::2], frames[1::2], strict=True)):
        assert data[12:] == (data_header(FACTORY_LINK) + bytes([i]) * 1206)[12:]
        identification = int.from_bytes(position[18:20])
        assert position[12:] == position_frame(FACTORY_LINK, bytes([i]) * 512, identification)[12:]


def test_broadcast_to_the_subnet_is_recognised(printed):
    """An address that is a broadcast address only by its netmask is sent to all stations too."""
    frames = [bytes.fromhex(line) for line in printed[9:]]
    assert len(frames) == 8
    assert {frame[:6] for frame in frames} == {b"\xff" * 6}
    assert {frame[30:34] for frame in frames} == {bytes([192, 168, 1, 255])}

"""Streams from the sensor's own address, on a cable between two networks that the test makes."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from ipaddress import IPv4Address

import pytest

from vlp16emu.packets.frames import FACTORY_LINK, data_header, position_frame

RECEIVER = """
import socket, subprocess, sys

def line(text):
    print(text, flush=True)

line("here")
sys.stdin.readline()
subprocess.run(["ip", "link", "set", "host0", "up"], check=True)
wire = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(0x0800))
wire.setsockopt(socket.SOL_SOCKET, 33, 16_000_000)  # SO_RCVBUFFORCE: frames wait for who reads them
wire.bind(("host0", 0x0800))
line("up")
while True:
    try:
        line(wire.recv(2000).hex())
    except OSError:
        line("down")
"""

IN_NAMESPACE = """
import array, contextlib, fcntl, io, json, socket, struct, subprocess, sys
from vlp16emu.cli.app import run

def ip(words):
    subprocess.run(["ip", *words.split()], check=True)

def stream(*words):
    command = [sys.executable, "-m", "vlp16emu", "stream", "static_bench", *words, "--json"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

def ended(*words):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = run(["stream", "static_bench", *words, "--json"])
    return {"code": code, "out": out.getvalue(), "err": err.getvalue()}

receiver = subprocess.Popen(
    ["unshare", "--net", sys.executable, "-c", sys.argv[1]],
    stdin=subprocess.PIPE,
    stdout=subprocess.PIPE,
    text=True,
)
assert receiver.stdout.readline() == "here\\n"
ip("link set lo up")
ip("link add sensor0 type veth peer name host0")
ip(f"link set host0 netns {receiver.pid}")
ip("link set sensor0 up")
receiver.stdin.write("go\\n")
receiver.stdin.flush()
assert receiver.stdout.readline() == "up\\n"
# Checksums are left to a network card by default, and there is none here: SIOCETHTOOL, ETHTOOL_STXCSUM 0.
value = array.array("I", [0x17, 0])
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
    fcntl.ioctl(control, 0x8946, struct.pack("16sP", b"sensor0", value.buffer_info()[0]))
outcomes = {}
outcomes["without address"] = ended("--as-sensor")
ip("addr add 192.168.1.201/24 dev sensor0")
ip("addr add 192.168.1.202/24 dev sensor0")
outcomes["whole"] = ended("--interface", "sensor0", "--duration", "0.1", "--set", "rig=[{}]")
report = json.loads(outcomes["whole"]["out"])
sent = report["packets"] + report["position_packets"]
outcomes["frames"] = [receiver.stdout.readline().strip() for _ in range(sent)]
going = stream("--interface", "sensor0", "--duration", "3600")
for _ in range(50):
    receiver.stdout.readline()
other_end = ["nsenter", f"--net=/proc/{receiver.pid}/ns/net", "ip", "link", "set", "host0"]
subprocess.run([*other_end, "down"], check=True)
while receiver.stdout.readline() != "down\\n":
    pass
outcomes["unplugged"] = going.poll()
subprocess.run([*other_end, "up"], check=True)
outcomes["plugged in"] = [receiver.stdout.readline().strip() for _ in range(50)]
ip("link del sensor0")
out, err = going.communicate(timeout=100)
outcomes["vanished"] = {"code": going.returncode, "out": out, "err": err}
receiver.kill()
print(json.dumps(outcomes))
"""

pytestmark = [
    pytest.mark.skipif(os.geteuid() != 0, reason="a private network needs root"),
    pytest.mark.skipif(
        not all(map(shutil.which, ("ip", "unshare", "nsenter"))), reason="needs iproute2, unshare and nsenter"
    ),
]


@pytest.fixture(scope="module")
def seen():
    """What streams printed, and the frames at the other end, in networks that are gone afterwards."""
    if subprocess.run(["unshare", "--net", "true"], capture_output=True, check=False).returncode:
        pytest.skip("this machine allows no private network")
    command = ["unshare", "--net", sys.executable, "-c", IN_NAMESPACE, RECEIVER]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=100)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_a_missing_address_is_answered_with_the_command_that_adds_it(seen):
    """On a machine without the sensor's address the line has what adds it, to an interface that there is."""
    ended = seen["without address"]
    assert (ended["code"], ended["out"]) == (2, "")
    assert ended["err"] == (
        "error: 192.168.1.201:2368: Cannot assign requested address; expected an address of this machine: "
        "sudo ip addr add 192.168.1.201/24 dev sensor0\n"
    )


def test_each_unit_of_a_rig_is_a_sensor_on_the_wire(seen):
    """With --interface all is broadcast, and from byte 12 on each unit's frames are a real sensor's with its
    own address and ports.

    Those of data have no checksum, TTL 255, don't fragment and identification 0; those of positions a
    checksum and TTL 64.
    """
    frames = [bytes.fromhex(frame) for frame in seen["frames"]]
    assert {frame[:6] for frame in frames} == {b"\xff" * 6}
    units = set()
    for frame in frames:
        source = str(IPv4Address(frame[26:30]))
        port, payload = int.from_bytes(frame[36:38]), frame[42:]
        link = replace(FACTORY_LINK, source=source, data_port=port, position_port=port)
        if len(payload) == 1206:
            assert frame[12:] == (data_header(link) + payload)[12:]
        else:
            assert frame[12:] == position_frame(link, payload, int.from_bytes(frame[18:20]))[12:]
        units.add((source, port, len(payload)))
    assert units == {
        ("192.168.1.201", 2368, 1206),
        ("192.168.1.201", 8308, 512),
        ("192.168.1.202", 2369, 1206),
        ("192.168.1.202", 8309, 512),
    }


def test_an_unplugged_cable_is_survived(seen):
    """While the other end of the cable is down the stream goes on, and frames arrive as soon as it is up
    again."""
    assert seen["unplugged"] is None
    assert {len(bytes.fromhex(frame)) for frame in seen["plugged in"]} <= {1248, 554}


def test_a_stream_whose_interface_vanishes_ends_at_once(seen):
    """The run fails with one line that names the packet; those before it have been sent."""
    ended = seen["vanished"]
    assert (ended["code"], ended["err"].count("error: ")) == (1, 1)
    assert "255.255.255.255:" in ended["err"]
    assert ended["err"].endswith("; those before it have been sent\n")

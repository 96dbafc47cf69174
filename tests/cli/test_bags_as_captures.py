"""Bags with the driver's packets, whole and damaged, at the verbs that take captures."""

import struct
from concurrent.futures import CancelledError
from threading import Event

import numpy as np
import pytest

from vlp16emu.captures import packet_clock, units_in
from vlp16emu.cli.app import run
from vlp16emu.extras.bag.write import write_bag
from vlp16emu.extras.clouds.deskew import Trajectory, write_deskewed
from vlp16emu.extras.options import TrajectoryErrors
from vlp16emu.extras.replay import Replay, write_pcap

pytest.importorskip("rosbags", reason="the extra ros is not installed")
VERBS = [
    "decode {bag}",
    "decode {bag} --pcap x.pcap",
    "verify {bag}",
    "replay {bag} --speed 1000 --data-port 9 --position-port 10",
    "bag {bag} x.mcap",
    "points {bag} x.npz --trajectory {truth}",
    "compare {bag} {pcap}",
    "fit {bag}",
]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Half a second of the hall as pcap, its ground truth and its bag, whole and without some bytes."""
    folder = tmp_path_factory.mktemp("bags")
    pcap = folder / "bench.pcap"
    truth = folder / "truth"
    words = ["record", "static_bench", str(pcap), "--truth", str(truth), "--duration", "0.5", "--json"]
    assert run([*words, "--set", "sensor.rpm=1200"]) == 0
    bag = folder / "bench.bag"
    write_bag(pcap, bag)
    content = bag.read_bytes()
    begin = content.rindex(b"op=\x02", 0, len(content) // 2)  # of a message
    damaged = folder / "damaged.bag"
    damaged.write_bytes(content[: begin - 20] + bytes(range(200, 237)) + content[begin + 17 :])
    return {"pcap": pcap, "truth": truth, "bag": bag, "damaged": damaged}


@pytest.mark.parametrize("words", VERBS)
def test_verbs_take_bags_of_packets(cli, made, words, tmp_path, monkeypatch):
    """A run as with a pcap, without a word on stderr."""
    monkeypatch.chdir(tmp_path)
    outcome = cli(*words.format(**made).split())
    assert (outcome.code, outcome.err) == (0, "")


@pytest.mark.parametrize("words", VERBS)
def test_verbs_tell_damage_once(cli, made, words, tmp_path, monkeypatch, caplog):
    """Each verb warns of each damaged part once, however often it reads the file."""
    monkeypatch.chdir(tmp_path)
    outcome = cli(*words.format(**made | {"bag": made["damaged"]}).split())
    assert outcome.code == (1 if words.startswith("verify") else 0)
    (record,) = (each for each in caplog.records if each.name == "vlp16emu.captures.capture")
    assert record.getMessage().startswith(f"{made['damaged']}: ")
    assert record.getMessage().endswith(" are damaged and left out")


def block(kind, body):
    """A block of pcapng (IETF draft-ietf-opsawg-pcapng, section 3.1)."""
    return struct.pack("<2I", kind, 12 + len(body)) + body + struct.pack("<I", 12 + len(body))


@pytest.mark.parametrize("words", VERBS)
def test_stamps_beyond_any_date_are_a_line(cli, made, words, tmp_path, monkeypatch):
    """A pcapng whose microseconds are declared to be seconds, past 64 bits in nanoseconds, ends with 2."""
    monkeypatch.chdir(tmp_path)
    section = block(0x0A0D0D0A, struct.pack("<I2Hq", 0x1A2B3C4D, 1, 0, -1))
    interface = block(1, struct.pack("<2HI2HB3x", 1, 0, 0, 9, 1, 0))
    stamp = 1_700_000_000_123_456
    packet = block(6, struct.pack("<5I", 0, stamp >> 32, stamp & 0xFFFFFFFF, 60, 60) + bytes(60))
    (tmp_path / "wild.pcapng").write_bytes(section + interface + packet)
    outcome = cli(*words.format(**made | {"bag": "wild.pcapng"}).split())
    assert (outcome.code, outcome.out) == (2, "")
    line = f"block 3: a stamp of {stamp} s since 1970; expected 0 to 4294967296, from 1970 to 2106"
    assert outcome.err == f"error: wild.pcapng: {line}\n"


def test_points_of_a_bag_are_those_of_its_pcap(cli, made, tmp_path):
    """Packets that both hold have the same points in the sensor's frame."""
    clouds = []
    for name in ("bag", "pcap"):
        out = tmp_path / f"{name}.npz"
        words = ["points", str(made[name]), str(out), "--trajectory", str(made["truth"]), "--clock", "sensor"]
        assert cli(*words).code == 0
        clouds.append(np.load(out))
    bag, pcap = clouds
    count = len(bag["sensor_m"])
    assert count > 100_000
    assert np.array_equal(bag["sensor_m"], pcap["sensor_m"][:count])


def deskewed(made, stop):
    way = Trajectory(made["truth"], 1, TrajectoryErrors())
    write_deskewed(made["pcap"], made["pcap"].with_name("x.npz"), way, None, stop=stop)


PASSES = [
    lambda made, stop: units_in(made["pcap"], stop=stop),
    lambda made, stop: packet_clock(made["pcap"], None, "fitted", stop=stop),
    lambda made, stop: Replay(made["bag"], stop=stop),
    lambda made, stop: write_bag(made["pcap"], made["pcap"].with_name("x.bag"), stop=stop),
    lambda made, stop: write_pcap(made["bag"], made["pcap"].with_name("x.pcap"), stop=stop),
    deskewed,
]


@pytest.mark.parametrize("search", PASSES)
def test_a_signal_ends_passes_before_the_output(made, search):
    """Once the event of a signal is set, no pass over the file goes on, and no output begins."""
    stop = Event()
    stop.set()
    with pytest.raises(CancelledError):
        search(made, stop)
    assert not list(made["pcap"].parent.glob("x.*"))

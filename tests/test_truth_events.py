"""Events in the truth: each with the numbers of its packets."""

import csv

import pytest

from vlp16emu import Emulator
from vlp16emu.extras.truth.truth import write_truth
from vlp16emu.run.options import TruthTo
from vlp16emu.scenario import load
from vlp16emu.types import PacketKind
from vlp16emu.units import S_NS

EVENTS = [
    {"kind": "drop", "at_s": 0.4, "share": 0.2, "packets": "both"},
    {"kind": "truncate", "at_s": 0.5, "count": 7},
    {"kind": "delay", "at_s": 0.6, "duration_s": 0.2, "by_s": 0.03},
    {"kind": "dead_laser", "at_s": 0.1, "laser": 3},
    {"kind": "setting", "at_s": 0.7, "return_mode": "dual"},
    {"kind": "pps_loss", "at_s": 0.3, "duration_s": 0.1},
    {"kind": "drop", "at_s": 5.0},
]


def emulator(*events):
    """A sensor on a tripod in a hall."""
    tables = {
        "schema": 1,
        "seed": 5,
        "duration_s": 1.2,
        "beam": {"model": "none"},
        "motion": {"kind": "static"},
        "world": {"kind": "hall", "length_m": 20.0, "width_m": 16.0, "height_m": 5.0},
        "events": list(events),
    }
    return Emulator(load(tables))


def rows(folder):
    """Rows of the file, times in seconds since the first pulse."""
    start_ns = emulator().scenario.start_ns
    with (folder / "events.csv").open() as file:
        found = list(csv.DictReader(file))
    for row in found:
        for key in ("t_utc_s", "until_utc_s"):
            row[key] = (int(row[key].replace(".", "")) - start_ns) / S_NS
    return found


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A recorded run with events, the packets of the same run without them, and its folder of truth."""
    folder = tmp_path_factory.mktemp("truth")
    made = emulator(*EVENTS)
    made.record(folder / "run.pcap", truth=folder / "truth")
    return made, list(emulator(EVENTS[4]).packets()), list(made.packets()), folder / "truth"


def test_packets_that_are_lost_are_listed_one_by_one(run):
    """Each lost packet has a row with its number, among those of its kind since the first pulse, and its
    time."""
    made, before, after, folder = run
    for kind in (PacketKind.DATA, PacketKind.POSITION):
        numbered = [packet for packet in before if packet.kind is kind]
        kept = {
            packet.number if kind is PacketKind.POSITION else packet.fired_ns
            for packet in after
            if packet.kind is kind
        }
        end_ns = made.scenario.start_ns + round(
            1.16 * S_NS
        )  # later ones may have been delayed beyond the end
        lost = {
            number
            for number, packet in enumerate(numbered)
            if packet.due_ns < end_ns
            and (packet.number if kind is PacketKind.POSITION else packet.fired_ns) not in kept
        }
        listed = [row for row in rows(folder) if row["kind"] == "drop" and row["packets"] == kind]
        assert {row["event"] for row in listed} == {"1"}
        assert {int(row["first"]) for row in listed if row["t_utc_s"] < 1.16} == lost
        assert all(row["first"] == row["last"] and row["count"] == "1" for row in listed)
        for row in listed:
            due_ns = numbered[int(row["first"])].due_ns - made.scenario.start_ns
            assert row["t_utc_s"] == row["until_utc_s"] == pytest.approx(due_ns / S_NS, abs=1e-6)


def test_what_lasts_has_one_row(run):
    """Begin, end and packets within of each event that hits all of them; those beyond the end of the run
    have none."""
    made, before, _, folder = run
    start_ns = made.scenario.start_ns
    listed = {row["kind"]: row for row in rows(folder) if row["kind"] != "drop"}
    assert set(listed) == {"truncate", "delay", "dead_laser", "setting", "pps_loss"}
    for kind, begin_s, end_s in (("delay", 0.6, 0.8), ("dead_laser", 0.1, 1.2), ("pps_loss", 0.3, 0.4)):
        row = listed[kind]
        due_ns = [packet.due_ns - start_ns for packet in before if packet.kind == row["packets"]]
        within = [number for number, due in enumerate(due_ns) if begin_s * S_NS <= due < end_s * S_NS]
        assert (row["t_utc_s"], row["until_utc_s"]) == pytest.approx((begin_s, end_s))
        assert [int(row[key]) for key in ("first", "last", "count")] == [within[0], within[-1], len(within)]
    assert listed["truncate"]["count"] == "7"
    assert listed["pps_loss"]["packets"] == "position"
    assert (listed["setting"]["count"], listed["setting"]["last"]) == ("0", "")
    times = [row["t_utc_s"] for row in rows(folder)]
    assert times == sorted(times)


def test_truth_alone_is_the_same(run, tmp_path):
    """Without packets, and from a part of a run, the rows are the same, those of events under way
    included."""
    _, _, _, folder = run
    write_truth(emulator(*EVENTS), TruthTo(tmp_path / "alone"))
    for name in ("events.csv", "trajectory.tum", "gnss.csv"):
        assert (tmp_path / "alone" / name).read_bytes() == (folder / name).read_bytes()
    write_truth(emulator(*EVENTS), TruthTo(tmp_path / "late"), start_s=0.65)
    late, whole = rows(tmp_path / "late"), rows(folder)
    assert [row for row in late if row["t_utc_s"] >= 0.65] == [row for row in whole if row["t_utc_s"] >= 0.65]
    assert {row["kind"] for row in late if row["t_utc_s"] < 0.65} == {"delay", "dead_laser", "truncate"} - {
        "truncate"
    }


def test_packets_have_poses_as_they_arrive(run, tmp_path):
    """With a pose per packet there is a row for each data packet that arrives, in its order."""
    made, _, after, _ = run
    made.record(tmp_path / "run.pcap", truth=TruthTo(tmp_path / "truth", per_packet=True))
    lines = (tmp_path / "truth" / "packets.tum").read_text().splitlines()[1:]
    fired = [packet.fired_ns for packet in after if packet.kind is PacketKind.DATA]
    assert [int(line.split()[0].replace(".", "")) for line in lines] == fired

"""Small files of kinds that people reported, each with its right answer and the authority for it.

The files are in `../shared/cases`, whose README names the public reports; they are no part of the project.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from vlp16emu.cli.app import run

CASES = Path(__file__).resolve().parents[2] / "shared" / "cases"

pytestmark = pytest.mark.skipif(not CASES.is_dir(), reason="the cases are not beside the repository")


class Case(NamedTuple):
    """A verb on a file, and what is right."""

    verb: str
    file: str
    options: str
    code: int
    right: Callable[[Any], bool]  # of the JSON object, or of the error line after exit code 2
    authority: str


def only_notes(*rules: str) -> Callable[[Any], bool]:
    """Return a check that `verify` finds no error, and of these rules one note or some."""
    return lambda tree: tree["clean"] and set(tree["notes"]) == set(rules)


def packets(number: int) -> Callable[[Any], bool]:
    return lambda tree: tree["packets"] == number


TSHARK, MAC = "tshark: datagrams of UDP length 1214", "velodyne#532: only the MAC differs"
FIELDS = "NMEA 0183: fields may be empty; the unit echoes what it gets"
CASE_LIST = [
    Case("decode", "01-sll.pcap", "", 0, packets(20), TSHARK),
    Case("decode", "03-rawip.pcap", "", 0, packets(20), TSHARK),
    Case("decode", "03b-null.pcap", "", 0, packets(20), TSHARK),
    Case("decode", "05-rotated.pcap.gz", "", 0, packets(37), TSHARK),
    Case("decode", "05b.pcap.zst", "", 0, packets(37), TSHARK),
    Case("decode", "04-wireshark.pcapng", "", 0, packets(20), TSHARK),
    Case("decode", "07-fragments.pcap", "", 0, packets(20), "RFC 791, section 3.2, reassembly; tshark"),
    Case(
        "verify",
        "07-fragments.pcap",
        "",
        1,
        lambda t: t["broken_rules"] == {"header": 20} and len(t["findings"]) == 1,
        "made so: 20 datagrams for one cause",
    ),
    Case("verify", "01-sll.pcap", "", 0, only_notes(), "tshark: the same datagrams as on Ethernet"),
    Case(
        "bag",
        "10-clock1970.pcap",
        "",
        0,
        lambda t: t["clocks"] == ["fitted"] and t["messages"],
        "README: a bag or a line",
    ),
    Case(
        "bag",
        "10-clock1970.pcap",
        "--clock sensor",
        2,
        lambda e: "-9.973 s since 1970" in e,
        "MCAP: log_time is a uint64",
    ),
    Case(
        "decode",
        "12-suspend.pcap",
        "",
        0,
        lambda t: 9000.03 < t["duration_s"] < 9000.05,
        "both clocks go on by 2.5 h",
    ),
    Case(
        "bag",
        "12-suspend.pcap",
        "",
        0,
        lambda t: 9000 < t["duration_s"] < 9000.1,
        "velodyne#384, #462: hour per packet",
    ),
    Case(
        "decode",
        "14-ntp-fwd.pcap",
        "",
        0,
        lambda t: 0.03 < t["duration_s"] < 0.05,
        "the sensor's clock runs on",
    ),
    Case(
        "decode",
        "15-dup.pcap",
        "",
        0,
        lambda t: t["packets"] == 17 and t["repeats"] == 17 + t["position_packets"],
        "each pulse once",
    ),
    Case("decode", "18-same-ip.pcap", "", 2, lambda e: "2 units" in e, MAC),
    Case("decode", "18-same-ip.pcap", "--unit 2", 0, packets(15), MAC),
    Case(
        "verify",
        "18-same-ip.pcap",
        "",
        0,
        lambda t: [unit["packets"] for unit in t["units"]] == [15, 15] and t["clean"],
        MAC,
    ),
    Case("bag", "18-same-ip.pcap", "--unit 1", 0, lambda t: len(t["clocks"]) == 1, MAC),
    Case("verify", "19-foreign.pcap", "", 0, only_notes(), "velodyne#306: the unit on 2368 is sound"),
    Case("decode", "19-foreign.pcap", "", 0, packets(26), "velodyne#306: the unit on 2368 is sound"),
    Case(
        "decode",
        "20-fov10-20.pcap",
        "",
        0,
        lambda t: t["rpm"] == pytest.approx(1200, abs=1),
        "recorded at 1200 rpm",
    ),
    Case(
        "verify",
        "20-fov10-20.pcap",
        "",
        0,
        only_notes("azimuth-gap"),
        "63-9243 Rev D, section 10.1: a setting",
    ),
    Case("verify", "21-rmc-nofix.pcap", "", 0, only_notes(), FIELDS),
    Case(
        "verify",
        "22-pps-absent.pcap",
        "",
        0,
        lambda t: t["notes"] == {"nmea-second": 1},
        "made so: 25 min apart",
    ),
    Case(
        "bag",
        "24-nogps.pcap",
        "",
        0,
        lambda t: t["host_ahead_s"] == [pytest.approx(-964.198, abs=1e-3)],
        "made so",
    ),
    Case(
        "verify",
        "25-gnrmc.pcap",
        "",
        0,
        lambda t: t["notes"] == {"nmea-format": 1},
        "the manual names GPRMC only",
    ),
    Case(
        "verify",
        "26-relayed.pcap",
        "",
        1,
        lambda t: t["broken_rules"] == {"ports": 2},
        "two streams, one cause each",
    ),
]


@pytest.mark.parametrize(
    "case", CASE_LIST, ids=lambda case: f"{case.verb} {case.file} {case.options}".rstrip()
)
def test_what_people_have_is_read_as_its_authority_says(case, tmp_path, capsys):
    """Each verb gives the right answer on the file, or one line that names what is wrong."""
    words = [case.verb, str(CASES / case.file), *case.options.split(), "--json"]
    if case.verb == "bag":
        pytest.importorskip("rosbags", reason="the extra ros is not installed")
        words.insert(2, str(tmp_path / "out.mcap"))
    if case.file.endswith(".zst"):
        pytest.importorskip("zstandard", reason="the extra that reads .zst is not installed")
    assert run(words) == case.code, case.authority
    said = capsys.readouterr()
    if case.code == 2:
        assert said.err.count("\n") == 1
        assert case.right(said.err), (said.err, case.authority)
    else:
        assert case.right(json.loads(said.out)), (said.out, case.authority)


def test_stamps_without_gps_are_those_of_the_host_and_of_the_sensor_on_request(tmp_path, capsys):
    """A unit without GPS has its clouds at the host's time, which the driver gives them without
    `gps_time`; 964 s later by its own."""
    pytest.importorskip("rosbags", reason="the extra ros is not installed")
    from rosbags.highlevel import AnyReader

    stamps_s = {}
    for clock in ("host", "sensor"):
        out = tmp_path / f"{clock}.mcap"
        assert run(["bag", str(CASES / "24-nogps.pcap"), str(out), "--clock", clock]) == 0
        with AnyReader([out]) as reader:
            stamps_s[clock] = [at_ns / 1e9 for _, at_ns, _ in reader.messages()]
    assert stamps_s["host"][0] == pytest.approx(1779269383.03, abs=0.05)  # 09:29:43 of 2026-05-20
    assert stamps_s["sensor"][0] - stamps_s["host"][0] == pytest.approx(964.198, abs=1e-3)
    capsys.readouterr()

"""Small files of kinds that people reported: a command for each, its right answer, and the authority for it.

Files are those of `../shared/cases`, whose README names the public reports, or copies in `tests/cases`.
"""

import json
from collections.abc import Mapping
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

from vlp16emu.cli.app import run

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ROOT.parent / "shared" / "cases", ROOT / "tests" / "cases"
BAD_INPUT = 2  # exit code of a refusal, whose line has the right answer

NO_PORTS = "--data-port 9 --position-port 10"
TSHARK = "tshark: datagrams of UDP length 1214"
MAC = "velodyne#532: only the MAC differs"
FIELDS = "NMEA 0183: fields may be empty; the unit echoes what it gets"
SOUND: Mapping[str, object] = {"clean": True, "notes": {}}
TREES = "the trees of scenes/own_plot/stems.csv"

Right = Mapping[str, object]
"""Values by place in the JSON object, a pair for bounds; for a refusal `error` and a part of its line."""


class Case(NamedTuple):
    """A command line on a file, {file} in its words, and what is right."""

    file: str
    kind: str  # what the file is
    words: str
    code: int
    right: Right
    authority: str


CASES = [
    Case("01-sll.pcap", "Linux cooked capture", "decode {file}", 0, {"packets": 20}, TSHARK),
    Case(
        "01-sll.pcap",
        "Linux cooked capture",
        "verify {file}",
        0,
        SOUND,
        "tshark: the same datagrams as on Ethernet",
    ),
    Case("03-rawip.pcap", "raw IP", "decode {file}", 0, {"packets": 20}, TSHARK),
    Case("03b-null.pcap", "BSD loopback", "decode {file}", 0, {"packets": 20}, TSHARK),
    Case("04-wireshark.pcapng", "pcapng", "decode {file}", 0, {"packets": 20}, TSHARK),
    Case("05-rotated.pcap.gz", "gzip", "decode {file}", 0, {"packets": 37}, TSHARK),
    Case("05b.pcap.zst", "zstd", "decode {file}", 0, {"packets": 37}, TSHARK),
    Case(
        "07-fragments.pcap",
        "IP fragments",
        "decode {file}",
        0,
        {"packets": 20},
        "RFC 791, section 3.2; tshark",
    ),
    Case(
        "07-fragments.pcap",
        "IP fragments",
        "verify {file}",
        1,
        {"broken_rules": {"header": 20}, "findings.#": 1},
        "made so: 20 datagrams for one cause",
    ),
    Case(
        "10-clock1970.pcap",
        "host clock of 1970",
        "bag {file} {out}.mcap",
        0,
        {"clocks": ["fitted"], "messages.#": (1, 9)},
        "README: a bag or a line",
    ),
    Case(
        "10-clock1970.pcap",
        "host clock of 1970",
        "bag {file} {out}.mcap --clock sensor",
        2,
        {"error": "-9.973 s since 1970"},
        "MCAP: log_time is a uint64",
    ),
    Case(
        "12-suspend.pcap",
        "laptop suspended for 2.5 h",
        "decode {file}",
        0,
        {"duration_s": (9000.03, 9000.05)},
        "both clocks go on by 2.5 h",
    ),
    Case(
        "12-suspend.pcap",
        "laptop suspended for 2.5 h",
        "bag {file} {out}.mcap",
        0,
        {"duration_s": (9000, 9000.1)},
        "velodyne#384, #462: hour per packet",
    ),
    Case(
        "14-ntp-fwd.pcap",
        "host clock set by 5 h",
        "decode {file}",
        0,
        {"duration_s": (0.03, 0.05)},
        "the sensor's clock runs on",
    ),
    Case(
        "14-ntp-fwd.pcap",
        "host clock set by 5 h",
        f"replay {{file}} {NO_PORTS}",
        0,
        {"packets": 30, "gaps_s.0": (17999, 18001), "sent.simulated_s": (1, 3)},
        "OUTPUTS.md: a gap is shortened",
    ),
    Case(
        "15-dup.pcap",
        "each frame twice",
        "decode {file}",
        0,
        {"packets": 17, "position_packets": 3, "repeats": 20},
        "each pulse once",
    ),
    Case("18-same-ip.pcap", "two units, one address", "decode {file}", 2, {"error": "2 units"}, MAC),
    Case("18-same-ip.pcap", "two units, one address", "decode {file} --unit 2", 0, {"packets": 15}, MAC),
    Case(
        "18-same-ip.pcap",
        "two units, one address",
        "verify {file}",
        0,
        {"units.0.packets": 15, "units.1.packets": 15, "units.#": 2, "clean": True},
        MAC,
    ),
    Case(
        "18-same-ip.pcap", "two units, one address", "bag {file} {out}.mcap --unit 1", 0, {"clocks.#": 1}, MAC
    ),
    Case(
        "19-foreign.pcap",
        "other traffic of 1206 bytes",
        "verify {file}",
        0,
        SOUND,
        "velodyne#306: the unit on 2368 is sound",
    ),
    Case(
        "19-foreign.pcap",
        "other traffic of 1206 bytes",
        "decode {file}",
        0,
        {"packets": 26},
        "velodyne#306: the unit on 2368 is sound",
    ),
    Case(
        "20-fov10-20.pcap",
        "field of view of 10 deg",
        "decode {file}",
        0,
        {"rpm": (1199, 1201)},
        "recorded at 1200 rpm",
    ),
    Case(
        "20-fov10-20.pcap",
        "field of view of 10 deg",
        "verify {file}",
        0,
        {"clean": True, "notes": {"azimuth-gap": 7}},
        "63-9243 Rev D, section 10.1: a setting",
    ),
    Case("21-rmc-nofix.pcap", "sentence without a fix", "verify {file}", 0, SOUND, FIELDS),
    Case(
        "22-pps-absent.pcap",
        "no pulse, sentence of another time",
        "verify {file}",
        0,
        {"notes": {"nmea-second": 1}},
        "made so: 25 min apart",
    ),
    Case(
        "23-stems-excel-de.csv",
        "stem list of German Excel",
        "forest own_plot --set world.stem_list={file}",
        0,
        {"trees.0.stems": 22},
        TREES,
    ),
    Case(
        "23c-stems-NA.csv",
        "stem list of R",
        "forest own_plot --set world.stem_list={file}",
        0,
        {"trees.0.stems": 22},
        TREES,
    ),
    Case(
        "23d-stems-cp1252.csv",
        "stem list in Windows-1252",
        "forest own_plot --set world.stem_list={file}",
        2,
        {"error": "line 2: no UTF-8 text: byte f6, in Windows-1252 'ö'"},
        "Windows-1252, byte f6",
    ),
    Case(
        "24-nogps.pcap",
        "no GPS, 16 min off",
        "bag {file} {out}.mcap",
        0,
        {"host_ahead_s.0": (-964.199, -964.197)},
        "made so",
    ),
    Case(
        "25-gnrmc.pcap",
        "$GNRMC",
        "verify {file}",
        0,
        {"notes": {"nmea-format": 1}},
        "the manual names GPRMC only",
    ),
    Case(
        "26-relayed.pcap",
        "relayed, other source ports",
        "verify {file}",
        1,
        {"broken_rules": {"ports": 2}},
        "two streams, one cause each",
    ),
    Case(
        "b01-stamps-1us-apart.pcap",
        "host stamps lost",
        f"replay {{file}} {NO_PORTS}",
        0,
        {"packets": 90, "sent.wall_s": (0.94 * 0.119, 60)},
        "63-9243 Rev D: 1327 us a packet",
    ),
    Case(
        "b03-times-all-zero.bag",
        "times all zero",
        "verify {file} --for fast-lio2",
        1,
        {"programs.fast-lio2.findings.0.rule": "times"},
        "FAST_LIO, preprocess.cpp",
    ),
    Case(
        "b04-half-turns.bag",
        "messages of half a turn",
        "verify {file} --for lio-sam",
        1,
        {"programs.lio-sam.findings.0.rule": "turn"},
        "LIO-SAM, imageProjection.cpp",
    ),
    Case(
        "b07-packets-only.bag",
        "bag of packets",
        "decode {file}",
        0,
        {"packets": 77},
        "rosbags: 77 packets in its message",
    ),
    Case(
        "b07-packets-only.bag",
        "bag of packets",
        "bag {file} {out}.mcap",
        0,
        {"messages./velodyne_points": 1},
        "rosbags: one turn",
    ),
    Case(
        "b09-cp1252.obj",
        "mesh in Windows-1252",
        "forest static_bench --set world.meshes=[{{file='{file}',unit='m',up='z',places=[{{x_m=3,y_m=0}}]}}]",
        0,
        {"report": "forest"},
        "trimesh#2355: read",
    ),
    Case(
        "b11-dxdy.asc",
        "grid with dx and dy",
        "forest own_plot --set world.dem.file={file}",
        0,
        {"relief.low_m": (-5.087, -5.085), "relief.high_m": (1.494, 1.496)},
        "GDAL, AAIGrid; scenes/own_plot/ground.asc",
    ),
    Case(
        "b12-times-from-zero.pcap",
        "trajectory from zero",
        "points {file} {out}.ply --trajectory {way} --time-offset auto",
        0,
        {"time_offset_s": -1779267599, "without_pose": 0},
        "made so",
    ),
    Case(
        "b12-times-from-zero.pcap",
        "trajectory from zero",
        "points {file} {out}.ply --trajectory {way} --time-offset -1779267599",
        0,
        {"without_pose": 0},
        "made so",
    ),
]
"""`b10-stems-dbh0.csv` and `23e-found-de.csv` are scored: `tests/test_cases_of_tables.py`."""


class Answer(NamedTuple):
    """What a command answered at the places of the right answer."""

    code: int
    found: Right
    is_right: bool
    said: str  # on standard error


def place_of(file: str) -> Path | None:
    """Return the path of a file of the cases; None if it is not at hand."""
    return next((folder / file for folder in FOLDERS if (folder / file).exists()), None)


def answer_of(case: Case, folder: Path) -> Answer:
    """Carry out the command of a case, with outputs in a folder."""
    file = place_of(case.file)
    assert file is not None
    names = {"file": file, "way": file.with_suffix(".tum"), "out": folder / "out"}
    words = [word.format(**names) for word in case.words.split()]
    out = StringIO()
    errors = StringIO()
    with redirect_stdout(out), redirect_stderr(errors):
        code = run([*words, "--json"])
    said = errors.getvalue()
    if code == BAD_INPUT:
        part = str(case.right.get("error"))
        line = said.splitlines()[-1]
        return Answer(code, {"error": line}, code == case.code and part in line, said)
    tree = json.loads(out.getvalue() or "{}")
    found = {place: value_at(tree, place) for place in case.right}
    is_right = all(_is_within(found[place], right) for place, right in case.right.items())
    return Answer(code, found, code == case.code and is_right, said)


def value_at(tree: Any, place: str) -> object:
    """Return the value at a place such as `units.0.packets`; `#` counts. None if there is no such place."""
    for name in place.split("."):
        if name == "#":
            tree = len(tree)
        elif isinstance(tree, list):
            tree = tree[int(name)] if int(name) < len(tree) else None
        else:
            tree = tree.get(name) if isinstance(tree, dict) else None
    return tree


def _is_within(found: object, right: object) -> bool:
    if isinstance(right, tuple):
        low, high = right
        return isinstance(found, int | float) and low <= found <= high
    return found == right

"""Small files of kinds that people reported, each with its right answer and the authority for it.

The rows are those of `tools/cases`. Most files are in `../shared/cases`, whose README names the public
reports; they are no part of the project.
"""

import pytest
from reported_cases import CASES, FOLDERS, answer_of, place_of

from vlp16emu.cli.app import run

NEEDS = {".zst": "zstandard", ".obj": "trimesh", ".bag": "rosbags", ".mcap": "rosbags"}
"""Modules of extras that read and write files of an ending."""


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.words.replace("{file}", case.file))
def test_what_people_have_is_read_as_its_authority_says(case, tmp_path):
    """Each verb gives the right answer on the file, or one line that names what is wrong."""
    for ending, module in NEEDS.items():
        if ending in f"{case.file} {case.words}":
            pytest.importorskip(module, reason=f"the extra that reads {ending} is not installed")
    if place_of(case.file) is None:
        pytest.skip("the cases are not beside the repository")
    answer = answer_of(case, tmp_path)
    assert answer.is_right, (answer, case.right, case.authority)
    assert answer.code != 2 or answer.said.count("error: ") == 1


@pytest.mark.parametrize("folder", FOLDERS)
def test_every_file_has_its_row(folder):
    """No file of the cases is without a command, but for those that are scored and ways of others."""
    names = {path.name for path in folder.glob("*.*") if path.suffix not in (".md", ".tum")}
    assert names - {case.file for case in CASES} <= {"b10-stems-dbh0.csv", "23e-found-de.csv"}


@pytest.mark.skipif(place_of("24-nogps.pcap") is None, reason="the cases are not beside the repository")
def test_stamps_without_gps_are_those_of_the_host_and_of_the_sensor_on_request(tmp_path, capsys):
    """A unit without GPS has its clouds at the host's time, which the driver gives them without
    `gps_time`; 964 s later by its own."""
    pytest.importorskip("rosbags", reason="the extra ros is not installed")
    from rosbags.highlevel import AnyReader

    stamps_s = {}
    for clock in ("host", "sensor"):
        out = tmp_path / f"{clock}.mcap"
        assert run(["bag", str(place_of("24-nogps.pcap")), str(out), "--clock", clock]) == 0
        with AnyReader([out]) as reader:
            stamps_s[clock] = [at_ns / 1e9 for _, at_ns, _ in reader.messages()]
    assert stamps_s["host"][0] == pytest.approx(1779269383.03, abs=0.05)  # 09:29:43 of 2026-05-20
    assert stamps_s["sensor"][0] - stamps_s["host"][0] == pytest.approx(964.198, abs=1e-3)
    capsys.readouterr()

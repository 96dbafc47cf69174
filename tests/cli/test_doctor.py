"""Whether a machine is fit."""

import socket

import pytest

from vlp16emu.extras.doctor import Condition
from vlp16emu.kernels import cache
from vlp16emu.raycast import embree

NAMES = [
    *("cores", "kernel cache", "Embree", "data port", "position port", "sensor address", "interface right"),
    *("clock resolution", "wake-ups", "receive buffer"),
    *(
        f"extra {name}"
        for name in ("cloud", "cluster", "data", "dem", "picture", "plot", "ros", "score", "viewer")
    ),
    "world cache",
]


def rows(outcome):
    return {check["name"]: check for check in outcome.tree["checks"]}


def test_each_row_has_a_finding_and_a_mend(cli):
    """All rows are there in their order, what is no ok has a mend, and counts and exit code are those of
    the rows."""
    outcome = cli("doctor", "--json")
    checks = rows(outcome)
    assert list(checks) == NAMES
    assert [name for name, check in checks.items() if check["finding"] != "ok" and not check["mend"]] == []
    for finding in Condition:
        assert outcome.tree[finding] == sum(check["finding"] == finding for check in checks.values())
    assert outcome.code == (outcome.tree["problem"] > 0)
    printed = cli("doctor").out.splitlines()
    assert [line[2:].split("  ")[0] for line in printed[1:]] == NAMES


def test_a_port_that_is_taken_is_a_warning(cli):
    """While another socket has the data port the row names the command that shows its program."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("", 2368))
        check = rows(cli("doctor", "--json"))["data port"]
    assert (check["finding"], check["found"]) == ("warning", "2368: Address already in use")
    assert "ss -ulpn 'sport = :2368'" in check["mend"]


def test_what_makes_runs_fail_is_a_problem(cli, monkeypatch):
    """Without Embree no scene can be cast, and the exit code is 1."""

    def missing():
        raise embree.EmbreeMissingError("libembree4.so.4: no such file")

    monkeypatch.setattr(embree, "device", missing)
    outcome = cli("doctor", "--json")
    assert (outcome.code, rows(outcome)["Embree"]["finding"]) == (1, "problem")


@pytest.mark.parametrize("extra", ["data", "dem", "picture", "ros"])
def test_a_missing_extra_names_what_needs_it(cli, monkeypatch, extra):
    """An extra that is not installed is a warning with the command that installs it."""
    monkeypatch.setattr("vlp16emu.libraries.find_spec", lambda _: None)
    check = rows(cli("doctor", "--json"))[f"extra {extra}"]
    assert (check["finding"], check["mend"]) == ("warning", f"pip install 'vlp16emu[{extra}]'")


def test_kernels_on_disk_are_looked_for(cli, monkeypatch, tmp_path):
    """A folder without kernels of casting is mended by compiling them, one that others can write by
    another one."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "base"))
    monkeypatch.setattr(cache, "user_kernels", cache.user_kernels.__wrapped__)
    monkeypatch.setattr("vlp16emu.extras.doctor.user_kernels", cache.user_kernels)
    check = rows(cli("doctor", "--json"))["kernel cache"]
    assert (check["finding"], check["mend"]) == ("warning", "vlp16emu cache --compile")
    folder = cache.user_kernels().usable_folder
    (folder / f"{cache.state_digest(cache.library_versions())}-raycast.kernel.cast-1-0-0.kernel").touch()
    check = rows(cli("doctor", "--json"))["kernel cache"]
    assert (check["finding"], check["found"]) == ("ok", f"1 kernels in {folder}")
    (tmp_path / "base").chmod(0o777)
    check = rows(cli("doctor", "--json"))["kernel cache"]
    assert check["finding"] == "warning"
    assert "NUMBA_CACHE_DIR" in check["mend"]

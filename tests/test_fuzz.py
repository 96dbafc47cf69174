"""`tools/fuzz`: its cases, and what it makes of a reader that fails."""

import pytest

NOTHING = [word for kind in ("scenes", "files", "options", "plugins") for word in (f"--{kind}", "0")]


@pytest.fixture(scope="module")
def fuzz(tool_named):
    return tool_named("fuzz")


@pytest.fixture(scope="module")
def cases(fuzz, tmp_path_factory):
    return fuzz.Cases(3, tmp_path_factory.mktemp("cases"), files=False)


def spin():
    while True:
        pass


def fill():
    return str(len(bytearray(10**9)))


def trip():
    raise ValueError("a fault of the program")


@pytest.mark.parametrize(
    ("reader", "said"),
    [
        (trip, "ValueError: a fault"),
        (spin, "fuzz.TooSlowError: more than 0.5 s of CPU time"),
        (fill, "MemoryError"),
    ],
)
def test_a_case_that_fails_is_kept(fuzz, cases, reader, said, tmp_path, capsys, monkeypatch):
    """A traceback, a loop and memory without bound exit with 1, and keep the input and the reason."""
    monkeypatch.setattr(fuzz, "Cases", lambda _seed, _folder, *, files: cases)
    monkeypatch.setattr(fuzz, "MOST_BYTES", 100_000_000)
    monkeypatch.setattr(fuzz, "read", lambda *_: reader())
    monkeypatch.setattr("sys.argv", ["fuzz", *NOTHING, "--captures", "1", "--out", str(tmp_path / "out")])
    if reader is spin:  # only that should end by time, however busy the machine is
        monkeypatch.setattr(fuzz, "MOST_S", 0.5)
    assert fuzz.main() == 1
    out = capsys.readouterr().out
    path = tmp_path / "out" / "captures-1-0.pcap"
    assert f"{path}: {said}" in out
    assert "captures: 1, 0 read, 0 refused, 1 failed\n" in out
    assert path.read_bytes() == cases.make("captures", 0).content
    assert said in path.with_suffix(".txt").read_text()

"""`tools/fuzz`: its cases, and what it makes of a reader that fails."""

import pytest


@pytest.fixture(scope="module")
def fuzz(tool_named):
    return tool_named("fuzz")


@pytest.fixture(scope="module")
def cases(fuzz, tmp_path_factory):
    return fuzz.Cases(3, tmp_path_factory.mktemp("cases"))


def test_a_case_is_decided_by_seed_and_number(fuzz, cases, tmp_path):
    """The same seed makes the same inputs, whatever was made before; another seed and number make others."""
    again = fuzz.Cases(3, tmp_path)
    kinds = [(kind, number) for kind in fuzz.READERS for number in range(30)]
    made = [cases.make(*kind) for kind in kinds]
    assert [again.make(*kind) for kind in reversed(kinds)] == made[::-1]
    assert len({case.content for case in made}) > 50
    again._seed = 4
    assert sum(again.make(*kind) == case for kind, case in zip(kinds, made, strict=True)) < 10


@pytest.mark.parametrize("kind", ["captures", "scenes"])
def test_the_readers_answer_or_refuse(fuzz, cases, tmp_path, kind):
    """The first twenty cases are read or refused with one line, and some of each."""
    outcomes = set()
    for number in range(20):
        case = cases.make(kind, number)
        path = tmp_path / f"case{case.suffix}"
        path.write_bytes(case.content)
        outcomes.add(fuzz.outcome_of(kind, path))
    assert outcomes == {("read", ""), ("refused", "")}


def spin(path):
    while True:
        pass


def fill(path):
    return str(len(bytearray(10**9)))


def trip(path):
    raise ValueError("a fault of the program")


@pytest.mark.parametrize(
    ("reader", "said"), [(trip, "ValueError: a fault"), (spin, "more than 0.5 s"), (fill, "MemoryError")]
)
def test_a_case_that_fails_is_kept(fuzz, cases, reader, said, tmp_path, capsys, monkeypatch):
    """A traceback, a loop and memory without bound exit with 1, and keep the input and the reason."""
    monkeypatch.setattr(fuzz, "Cases", lambda seed, folder: cases)
    monkeypatch.setattr(fuzz, "MOST_BYTES", 100_000_000)
    monkeypatch.setitem(fuzz.READERS, "captures", reader)
    monkeypatch.setattr("sys.argv", ["fuzz", "--scenes", "0", "--captures", "1", "--out", str(tmp_path / "out")])
    if reader is spin:  # only that should end by time, however busy the machine is
        monkeypatch.setattr(fuzz, "MOST_S", 0.5)
    assert fuzz.main() == 1
    out = capsys.readouterr().out
    path = tmp_path / "out" / "captures-1-0.pcap"
    assert f"{path}: {said}" in out
    assert "captures: 1, 0 read, 0 refused, 1 failed\n" in out
    assert path.read_bytes() == cases.make("captures", 0).content
    assert said in path.with_suffix(".txt").read_text()

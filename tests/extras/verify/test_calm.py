"""Runs of calm packets, which are taken at once, beside packets that are taken one by one."""

import random

import pytest

from vlp16emu.extras.verify import run

HOUR_US = 3_600_000_000


def untouched(made, drawn):
    """Leave all as it is."""


def swapped(made, drawn):
    """Exchange neighbouring packets."""
    for i in drawn.sample(range(10, len(made.frames) - 10), 4):
        made.frames[i], made.frames[i + 1] = made.frames[i + 1], made.frames[i]


def repeated(made, drawn):
    """Send some packets again, a few packets later."""
    for i in sorted(drawn.sample(range(10, len(made.frames) - 20), 4), reverse=True):
        made.frames.insert(i + 5, bytearray(made.frames[i]))
        made.stamps_us.insert(i + 5, made.stamps_us[i + 4])


def dropped(made, drawn):
    """Lose packets."""
    made.drop(drawn.sample(range(10, len(made.frames) - 10), 5))


def set_clock(made, drawn):
    """Set the host's clock, and let one stamp precede the one before it."""
    at = drawn.randrange(300, len(made.frames) - 300)
    for i in range(at, len(made.frames)):
        made.stamps_us[i] += 7_000_000
    back = drawn.randrange(100, at)
    made.stamps_us[back] = made.stamps_us[back - 1] - 3


def silent(made, drawn):
    """Leave out everything for most of a second."""
    begin = made.stamps_us[drawn.randrange(200, 700)]
    made.drop([i for i, t in enumerate(made.stamps_us) if 0 <= t - begin < 800_000])


def other_mode(made, drawn):
    """Change the byte of the return mode from a packet on."""
    for i in made.data(slice(drawn.randrange(200, 900), None)):
        made.payload(i)["return_mode"] = 0x38


def unlocked(made, drawn):
    """Let the state of the pulse per second fall and rise again."""
    first = drawn.randrange(20, 100)
    for i in made.position(slice(first, first + 30)):
        made.write_position(i, 202, b"\0")


def relayed(made, drawn):
    """Send a packet from another port, and one that is too short."""
    made.frames[drawn.randrange(50, 900)][34:36] = (9).to_bytes(2)
    at = made.data(drawn.randrange(100, 900))
    del made.frames[at][-6:]


@pytest.mark.parametrize(
    "damage",
    [untouched, swapped, repeated, dropped, set_clock, silent, other_mode, unlocked, relayed],
    ids=lambda damage: damage.__name__,
)
@pytest.mark.parametrize("seed", [1, 2])
def test_runs_find_what_single_packets_show(traffic, monkeypatch, damage, seed):
    """A capture has the same findings, counts and spans whether calm packets are taken at once or all of
    them one by one."""
    made = traffic(3.4)
    damage(made, random.Random(seed))
    taken = []
    take_run = run._Check._take_run

    def counted(check, datagrams):
        taken.append(take_run(check, datagrams))
        return taken[-1]

    monkeypatch.setattr(run._Check, "_take_run", counted)
    at_once = made.verified()
    monkeypatch.setattr(run._Check, "_take_run", lambda *_: False)
    assert made.verified() == at_once
    assert sum(taken) >= len(taken) // 4  # else nothing is compared
    if damage is untouched:
        assert sum(taken) >= len(taken) - 3  # the first packets, and the one at the full hour


def test_run_over_a_chunk_s_end_is_split_there(traffic, monkeypatch):
    """Chunks end at the same packets whatever the length of the runs."""
    made = traffic(2.2)
    results = []
    for longest in (1, 7, 256, 2000):
        monkeypatch.setattr(run, "LONGEST", longest)
        results.append(made.verified())
    assert all(result == results[0] for result in results)

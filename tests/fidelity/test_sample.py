"""Which pulses accuracy looks at."""

import numpy as np
import pytest

from vlp16emu.fidelity.sample import GROUP, draw_groups
from vlp16emu.pipeline import Cut

CUT = Cut(16, 55_296)


def owned(group):
    return group.first + group.own.start


@pytest.mark.parametrize("moves", [False, True])
def test_groups_are_spread_over_the_run(moves):
    """Each of equal spans of time has its group, whatever is drawn, and a group is of the stretch it is given with."""
    blocks = 4 * CUT.stretch
    drawn = list(draw_groups(CUT, blocks, 4096, 7, moves=moves))
    groups = [group for _, of_stretch in drawn for group in of_stretch]
    assert len(groups) == 4096 // (GROUP * 16)
    at = np.array([owned(group) for group in groups]) / (blocks * CUT.block)
    assert (np.floor(at * len(groups)) == np.arange(len(groups))).all()
    if moves:
        for stretch, of_stretch in drawn:
            assert {owned(group) // CUT.block // CUT.stretch for group in of_stretch} == {stretch}


def test_groups_have_their_neighbours_and_stay_within_their_block():
    """A group is cast with eight sequences on either side, but for those that lie beyond its block."""
    seen = set()
    for seed in range(60):
        for _, groups in draw_groups(CUT, 2, 16 * 128, seed, moves=True):
            for group in groups:
                last = group.first + group.count - 1
                assert group.first // CUT.block == last // CUT.block
                before, after = group.own.start, group.count - group.own.stop
                assert before == (0 if owned(group) % CUT.block == 0 else GROUP)
                assert after == (0 if (owned(group) + GROUP) % CUT.block == 0 else GROUP)
                seen.add((before, after))
    assert (GROUP, GROUP) in seen
    assert len(seen) > 1


def test_a_long_walk_opens_few_windows():
    """Of an hour's walk eight stretches are looked at, one from each eighth of it."""
    blocks = 530 * CUT.stretch
    stretches = np.array([stretch for stretch, _ in draw_groups(CUT, blocks, 8192, 1, moves=True)])
    assert (stretches * 8 // 530 == np.arange(8)).all()

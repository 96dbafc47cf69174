"""Which pulses accuracy looks at."""

import numpy as np
import pytest

from vlp16emu.engine.windows import Batching
from vlp16emu.extras.accuracy.sweep import GROUP, draw_groups

BATCHING = Batching(16, 55_296)


@pytest.mark.parametrize("moves", [False, True])
def test_groups_are_spread_over_the_run(moves):
    """Each of equal spans of time has its group, whatever is drawn, and a group is of the segment it is given with."""
    blocks = 4 * BATCHING.segment
    drawn = list(draw_groups(BATCHING, blocks, 4096, 7, moves=moves))
    groups = [group for _, of_segment in drawn for group in of_segment]
    assert len(groups) == 4096 // (GROUP * 16)
    at = np.array([group.start for group in groups]) / (blocks * BATCHING.block)
    assert (np.floor(at * len(groups)) == np.arange(len(groups))).all()
    if moves:
        for segment, of_segment in drawn:
            assert {group.start // BATCHING.block // BATCHING.segment for group in of_segment} == {segment}


def test_groups_are_eights_of_a_run():
    """A group is what a run judges an adaptive beam in: eight sequences from a multiple of eight on."""
    seen = set()
    for seed in range(60):
        for _, groups in draw_groups(BATCHING, 2, 16 * 128, seed, moves=True):
            assert all(len(group) == GROUP and group.start % GROUP == 0 for group in groups)
            assert all(0 <= group.start < 2 * BATCHING.block for group in groups)
            seen |= {group.start for group in groups}
    assert len(seen) > 100


def test_a_long_walk_opens_few_windows():
    """Of an hour's walk eight segments are looked at, one from each eighth of it."""
    blocks = 530 * BATCHING.segment
    segments = np.array([segment for segment, _ in draw_groups(BATCHING, blocks, 8192, 1, moves=True)])
    assert (segments * 8 // 530 == np.arange(8)).all()

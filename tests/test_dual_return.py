"""Dual return in a forest: each pair of records in the packets."""

import pytest

from vlp16emu.emulator import Emulator
from vlp16emu.scenario import load

pytestmark = pytest.mark.usefixtures("kept_woods")

SPAN_S = 5.0, 5.3
RESOLUTION_M = 1.0
THIN = "seed=5", "world.stems_per_ha=150", "sensor.max_range_m=25.0"


@pytest.fixture(scope="module")
def dual_returns(tool_named):
    """The tool that tells the shares of returns in several forests."""
    return tool_named("dual_returns")


@pytest.fixture(scope="module")
def forest(dual_returns):
    """Emulators of a walk among birches by the preset of their noise, in one world."""
    typical, ideal = (
        load("birch_walk", [*dual_returns.OWN, f"noise.preset={preset}", *THIN]) for preset in ("typical", "ideal")
    )
    first = Emulator(typical)
    return {"typical": first, "ideal": Emulator(ideal, like=first)}


@pytest.fixture(scope="module", params=["typical", "ideal"])
def pairs(dual_returns, forest, request):
    """Three revolutions."""
    return dual_returns.pairs(forest[request.param], *SPAN_S)


def test_every_pair_of_a_forest_is_lawful(dual_returns, pairs):
    """No pair breaks a rule of dual return, and there are thousands with no, one and two returns."""
    blocks, distances = pairs
    assert set(dual_returns.broken(blocks, distances, RESOLUTION_M).values()) == {0}
    numbers = dual_returns.shares(blocks) * blocks[:, ::2]["records"].size
    assert numbers[:3].min() > 1000


def test_swapped_blocks_are_found_out(dual_returns, pairs):
    """The rules would break if odd blocks were even ones."""
    blocks, distances = pairs
    swapped = blocks.reshape(-1, 6, 2)[:, :, ::-1].reshape(blocks.shape)
    wrong = dual_returns.broken(swapped, distances, RESOLUTION_M)
    for rule in ("the last return is nearer", "even block is not the last", "the strongest is outshone"):
        assert wrong[rule] > 300

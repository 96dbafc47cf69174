"""Seeds of the stand, the walk and the sensor, apart from one another."""

import numpy as np
import pytest
from woods import LINES

from vlp16emu import Emulator
from vlp16emu.scenario import load
from vlp16emu.scenario.model import Scenario
from vlp16emu.types import Semantic

pytestmark = pytest.mark.usefixtures("kept_woods")

SHORT = [*LINES, "beam.model=none", "sensor.start_azimuth_deg=0.1"]


def scan(*settings):
    """The first scan of a walk, with the stand's trees and the place of the walker after 2 s."""
    emulator = Emulator(load("birch_walk", [*SHORT, *settings]))
    first = next(iter(emulator.scans(duration_s=0.15, truth=True)))
    pose = emulator.world_T_sensor(np.array([emulator.scenario.start_ns + 2_000_000_000]))
    trees = first.labels.instance[first.labels.semantic == Semantic.TREE]
    return first, set(trees.tolist()), pose


@pytest.fixture(scope="module")
def plain():
    """With the seed of the scene alone."""
    return scan()


def test_the_scenes_seed_is_that_of_all_three(plain):
    """The three seeds set to the scene's own give the very points of a scene without them."""
    same, _, pose = scan("world.seed=5", "motion.seed=5", "sensor.seed=5")
    np.testing.assert_array_equal(same.xyz_m, plain[0].xyz_m)
    np.testing.assert_array_equal(pose, plain[2])


def test_another_sensor_sees_the_same_stand_on_the_same_walk(plain):
    """With another `sensor.seed` poses are the same to the bit, the same plants are seen, and ranges have
    other noise."""
    other, plants, pose = scan("sensor.seed=6")
    np.testing.assert_array_equal(pose, plain[2])
    assert len(plants & plain[1]) > 0.9 * len(plants | plain[1]) > 9
    assert not np.array_equal(other.distance_m[:1000], plain[0].distance_m[:1000])


def test_another_walk_is_through_the_same_stand(plain):
    """With another `motion.seed` the steps are others, by less than the trunk sways, in the same stand."""
    _, plants, pose = scan("motion.seed=6")
    gap_m = np.linalg.norm((pose - plain[2])[0, :3, 3])
    assert 1e-4 < gap_m < 0.3
    assert len(plants & plain[1]) > 0.9 * len(plants | plain[1])


def test_another_stand_has_other_trees(plain):
    """With another `world.seed` it is another stand: plants are named by place, so few names are in both."""
    _, plants, _ = scan("world.seed=6")
    assert len(plants & plain[1]) < 0.5 * len(plants | plain[1])


def test_units_of_a_rig_do_not_take_the_first_ones_seed():
    """`sensor.seed` is that of unit 1; unit 2 draws its own from it, or has the one that is given."""
    from vlp16emu.engine.build import seed_of

    def seeds(rig, **sensor):
        tree = load("static_bench").model_dump(mode="json", by_alias=True, exclude_none=True)
        scenario = Scenario.model_validate(tree | {"sensor": sensor, "rig": [rig]}, strict=False)
        return [seed_of(scenario, unit) for unit in range(2)]

    assert seeds({}) == seeds({}, seed=1)
    assert seeds({}, seed=7)[0] == 7
    assert seeds({}, seed=7)[1] not in (7, seeds({})[1])
    assert seeds({"seed": 9}, seed=7) == [7, 9]

"""Where a person goes, and recorded poses, as a scene gives them."""

import pytest

from vlp16emu.errors import ScenarioError
from vlp16emu.scenario import load

MOWER = "lawn_mower = { length_m = 30, width_m = 20 }"
POINTS = "way_points_m = [[0, 0], [9, 1]]"
EITHER = "exactly one of way_points_m, way_points_file and lawn_mower in it"
TIMES = "exactly one of times_file and rate_hz with format kitti, and neither with others"


WORLD = '[world]\nkind = "hall"\nlength_m = 60.0\nwidth_m = 40.0\nheight_m = 5.0\n'


def scene(folder, motion):
    path = folder / "scene.toml"
    path.write_text(f'schema = 1\ntitle = "t"\n[motion]\n{motion}\n{WORLD}', encoding="utf-8")
    return str(path)


@pytest.mark.parametrize(
    ("motion", "key", "expected"),
    [
        ('kind = "walk"', "motion", EITHER),
        (f'kind = "walk"\n{POINTS}\n{MOWER}', "motion", EITHER),
        (f'kind = "walk"\n{POINTS}\nspeed_m_s = 1.0\nrun_time_s = 9.0', "motion", "one of speed_m_s and run_time_s in it, not both"),
        (f'kind = "walk"\n{POINTS}\nstops = [{{ pause_s = 3 }}]', "motion.stops[0]", "exactly one of way_point and at_m in it"),
        (f'kind = "walk"\n{MOWER}\nstops = [{{ way_point = 2, pause_s = 3 }}]', "motion", "stops given by at_m where lawn_mower makes the waypoints"),
        ('kind = "recorded"\nfile = "p"\nformat = "kitti"', "motion", TIMES),
        ('kind = "recorded"\nfile = "p"\nformat = "tum"\nrate_hz = 10', "motion", TIMES),
    ],
)  # fmt: skip
def test_what_is_missing_or_given_twice_is_refused(tmp_path, motion, key, expected):
    """The table is named, with what it should hold."""
    path = scene(tmp_path, motion)
    with pytest.raises(ScenarioError) as caught:
        load(path)
    assert str(caught.value) == f"{path}: {key}: found a table; expected {expected}"


@pytest.mark.parametrize("rate_hz", ["1e-300", "1e300"])
def test_poses_come_at_a_rate_that_nanoseconds_can_hold(tmp_path, rate_hz):
    """A rate of poses whose times would not fit into nanoseconds is refused before the file is read."""
    path = scene(tmp_path, f'kind = "recorded"\nfile = "p"\nformat = "kitti"\nrate_hz = {rate_hz}')
    with pytest.raises(ScenarioError, match=r"rate_hz: found 1e[-+]300; expected a number from 0\.001 to 1000000$"):
        load(path)

"""Scene files: what is read, and what is said about files that are none."""

from pathlib import Path

import dpkt
import pytest

from vlp16emu.engine import assemble
from vlp16emu.errors import InputError, ScenarioError
from vlp16emu.scenario import load
from vlp16emu.sinks import PcapSink
from vlp16emu.types import Packet, PacketKind

SCENE = """\
schema = 1
title = "A bench"
[sensor]
rpm = 600
[motion]
kind = "static"
[world]
kind = "hall"
length_m = 30
width_m = 18.0
height_m = 6.0
"""

WALK = """\
schema = 1
title = "A walk"
[motion]
kind = "walk"
way_points_m = [[0, 0], [10, 5]]
[world]
kind = "forest"
species = [{ species = "silver_birch", share = 1.0, dbh_cm = 18, height_m = 19 }]
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_byte_order_mark_is_no_fault(tmp_path):
    """A scene that an editor has begun with a UTF-8 mark is the scene that it is without."""
    path = tmp_path / "scene.toml"
    path.write_text(SCENE, encoding="utf-8-sig")
    assert load(str(path)) == load(str(written(tmp_path, SCENE)))


def test_a_whole_number_is_taken_where_a_fraction_may_stand(tmp_path):
    """`length_m = 30` is 30.0: nobody has to write the point."""
    scenario = load(str(written(tmp_path, SCENE)), ["duration_s=5"])
    assert (scenario.world.length_m, scenario.duration_s) == (30.0, 5.0)


@pytest.mark.parametrize(
    ("settings", "own_keys"),
    [
        (["motion.way_points_file=way.csv"], {"way_points_file", "speed_m_s"}),
        (["motion.lawn_mower={ length_m = 20, width_m = 10 }"], {"lawn_mower", "speed_m_s"}),
        (["motion.lawn_mower.length_m=20", "motion.lawn_mower.width_m=10"], {"lawn_mower", "speed_m_s"}),
        (["motion.run_time_s=60"], {"way_points_m", "run_time_s"}),
    ],
)
def test_a_setting_takes_the_place_of_what_it_rules_out(settings, own_keys):
    """A scene that is told another way or pace by `--set` forgets its own."""
    motion = load("reference_forest", settings).motion
    assert motion.model_fields_set == own_keys | {"kind"}


@pytest.mark.parametrize(
    ("settings", "same"),
    [
        (["sensor.return_mode=Dual"], ["sensor.return_mode=dual"]),
        (["sensor.model=VLP-16"], []),
        (["sensor.rpm=1200.0", "seed=1.0"], ["sensor.rpm=1200"]),
        (["sensor={ rpm = 300.0, return_mode = 'LAST' }"], ["sensor.rpm=300", "sensor.return_mode=last"]),
        (["motion.gait=strong"], ["motion.gait={ preset = 'strong' }"]),
        (["motion.gait=strong", "motion.gait.yaw_deg=1"], ["motion.gait={ preset = 'strong', yaw_deg = 1 }"]),
        (["noise=ideal", "imu=consumer"], ["noise.preset=ideal", "imu.preset=consumer"]),
    ],
)
def test_a_setting_is_taken_as_it_is_meant(tmp_path, settings, same):
    """Words in any case, whole numbers with a point, and a preset's name for its table are what they stand for."""
    scene = str(written(tmp_path, WALK + "stems_per_ha = 500\n"))
    assert load(scene, settings) == load(scene, same)


@pytest.mark.parametrize(
    "settings",
    [
        ["motion.way_points_file=way.csv"],
        ["motion={ kind = 'walk', way_points_file = 'way.csv' }"],
        {"motion.way_points_file": "way.csv"},
    ],
)
def test_files_of_settings_are_found_from_here(tmp_path, monkeypatch, settings):
    """A file that a setting names lies in the current folder, wherever the scene is."""
    (tmp_path / "here").mkdir()
    scene = str(written(tmp_path, WALK + "stems_per_ha = 500\n"))
    monkeypatch.chdir(tmp_path / "here")
    assert load(scene, settings).motion.way_points_file == str(tmp_path / "here" / "way.csv")


def test_a_setting_is_not_blamed_for_a_fault_of_the_file(tmp_path):
    """A file that is wrong by itself is named, whatever is set."""
    scene = written(tmp_path, WALK + "stems_per_ha = 500\n[sensor]\nmin_range_m = 120.0\n")
    with pytest.raises(ScenarioError, match=rf"^{scene}: sensor.max_range_m: found 100.0"):
        load(scene, ["seed=7"])


def test_all_missing_keys_are_reported_at_once(tmp_path):
    """A file that lacks several keys names all of them, with what each should be."""
    path = written(tmp_path, '[motion]\nkind = "static"\n[world]\nkind = "hall"\nheight_m = 6\n')
    with pytest.raises(ScenarioError) as caught:
        load(path)
    size = "a number from 0.001 to 10000"
    assert str(caught.value) == (
        f"{path}: schema, world.length_m, world.width_m: missing; "
        f"expected schema = 1, world.length_m = {size}, world.width_m = {size}"
    )


def test_a_scene_without_a_title_has_that_of_its_file(tmp_path):
    """The title is the file's name unless it is given."""
    scene = written(tmp_path, WALK.replace('title = "A walk"\n', "") + "stems_per_ha = 500\n")
    assert load(scene).title == "scene"
    assert load(scene.rename(tmp_path / "my_walk.toml")).title == "my_walk"


def test_settings_apply_in_order_and_create_tables(tmp_path):
    """The last setting of a key wins, bare words are strings, absent tables appear."""
    settings = [
        "sensor.rpm=300",
        "sensor.rpm=1200",
        "sensor.return_mode=dual",
        "gps.connected=false",
        "title=two words",
    ]
    scenario = load(str(written(tmp_path, SCENE)), settings)
    assert (scenario.sensor.rpm, scenario.sensor.return_mode) == (1200, "dual")
    assert (scenario.gps.connected, scenario.title) == (False, "two words")


def test_the_last_setting_of_a_key_is_the_one_blamed(tmp_path):
    """Of two settings of one key, the error names the one in force."""
    with pytest.raises(ScenarioError, match=r"^--set sensor\.rpm=2: "):
        load(str(written(tmp_path, SCENE)), ["sensor.rpm=1", "sensor.rpm=2"])


def test_a_scenario_cannot_be_changed(tmp_path):
    """A scenario is frozen once read."""
    scenario = load(str(written(tmp_path, SCENE)))
    with pytest.raises(ValueError, match="frozen"):
        scenario.sensor.rpm = 300


@pytest.mark.parametrize(
    "start",
    [
        "0001-01-01T00:00:00+14:00",
        "1969-12-31T23:59:58+00:00",
        "1970-01-01T00:00:00+00:01",
        "2106-01-01T00:00:00+00:00",
        "2105-12-31T23:59:59-01:00",
        "9999-12-31T23:59:59-14:00",
    ],
)
def test_a_start_that_no_capture_can_be_stamped_with_is_reported(tmp_path, start):
    """A start before 1970 or after 2105 in UTC is refused, whatever its offset."""
    with pytest.raises(ScenarioError) as caught:
        load(str(written(tmp_path, SCENE)), [f"start_utc={start}"])
    expected = "a time from 1970 to 2105, as captures can be stamped with"
    assert str(caught.value) == f"--set start_utc={start}: found {start}; expected {expected}"


@pytest.mark.parametrize("start", ["1970-01-01T00:00:00Z", "2105-12-31T23:59:59Z"])
def test_the_longest_run_from_the_first_and_the_last_start_fits_a_capture(tmp_path, start):
    """From either end a packet two weeks later, the latest there is, is stamped in 32 bits without sign."""
    start_ns = load(str(written(tmp_path, SCENE)), [f"start_utc={start}"]).start_ns
    due_ns = start_ns + 14 * 86_400 * 10**9
    path = tmp_path / "late.pcap"
    with PcapSink(path) as sink:
        sink.send(Packet(PacketKind.DATA, start_ns, bytes(1206)))
        sink.send(Packet(PacketKind.DATA, due_ns, bytes(1206)))
    with path.open("rb") as file:
        assert [int(stamp_s) for stamp_s, _ in dpkt.pcap.Reader(file)] == [start_ns // 10**9, due_ns // 10**9]


def test_start_is_exact_in_nanoseconds(tmp_path):
    """A start time with an offset and microseconds becomes exact UTC nanoseconds."""
    scenario = load(str(written(tmp_path, SCENE)), ["start_utc=2026-05-20T11:00:00.000001+02:00"])
    assert scenario.start_ns == 1_779_267_600_000_001_000  # `date -d 2026-05-20T09:00:00Z +%s`


def test_an_ideal_scene_has_no_errors_but_those_that_are_set(tmp_path):
    """Width, noise, weather and the errors of each unit are gone; what a setting wants stays."""
    scene = tmp_path / "scene.toml"
    unit = "eccentricity_deg = 0.5\nazimuth_noise_deg = 0.02\nclock_error_ppm = 20.0\n"
    text = SCENE.replace("[sensor]\n", f"[sensor]\n{unit}")
    scene.write_text(f"{text}\n[[rig]]\n{unit}\n[weather]\nrain_mm_h = 5.0\n")
    ideal = load(str(scene), ["noise.range_noise_m=0.01"], ideal=True)
    assert (ideal.beam.summary, ideal.weather.summary) == ("none: one ray, without width", None)
    assert (ideal.noise.range_noise_m, ideal.noise.range_bias_m) == (0.01, 0.0)
    for sensor in (ideal.sensor, *ideal.rig):
        assert (sensor.eccentricity_deg, sensor.azimuth_noise_deg, sensor.clock_error_ppm) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "setting",
    [
        "motion.laps=1000000",
        "motion.sensor_height_m=1e300",
        "motion.gait.sideways_m=1e5",
        "motion.lawn_mower={length_m=1e9,width_m=2.0}",
        "motion.lawn_mower={length_m=20.0,width_m=20.0,turn_radius_m=1e-9}",
        "motion={kind='static',x_m=1e300}",
        "world.pattern={kind='plantation',row_spacing_m=1e-9}",
        "world.species=[{species='silver_birch',share=1e300,dbh_cm=18,height_m=19}]",
        "world.logs={per_ha=30,diameter_m=[1e-300,1e-300]}",
        "world.basal_area_m2_per_ha=120",
        "imu.gyro_noise_rad_s_sqrt_hz=1e308",
        "beam.target_m=1e-300",
    ],
)
def test_sizes_that_nothing_has_are_refused(tmp_path, setting):
    """Lengths, counts and errors beyond all use are refused by name and limit, before memory or time are gone."""
    scene = tmp_path / "walk.toml"
    small = WALK.replace("dbh_cm = 18, height_m = 19", "dbh_cm = 5, height_m = 3")
    scene.write_text(small if "basal" in setting else WALK + "stems_per_ha = 500\n")
    key = setting.split("=")[0].split(".")[0]
    with pytest.raises(InputError, match=rf"{key if key != 'world' else ''}.*expected .*\d"):
        assemble(load(str(scene), [setting]))


def test_saplings_of_dead_trees_are_refused(tmp_path):
    """Young trees without a species need a living one in the canopy."""
    scene = tmp_path / "walk.toml"
    scene.write_text(WALK.replace("silver_birch", "snag") + "stems_per_ha = 500\n")
    with pytest.raises(InputError, match=r"regeneration.species: found none, .*; expected names of species"):
        assemble(load(str(scene), ["world.regeneration={stems_per_ha=200}"]))

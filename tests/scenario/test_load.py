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


def test_a_file_is_read_as_it_is_meant(tmp_path):
    """A mark of UTF-8 is no fault, `length_m = 30` is 30.0, and a scenario cannot be changed once it is read."""
    marked = tmp_path / "scene.toml"
    marked.write_text(SCENE, encoding="utf-8-sig")
    scenario = load(str(marked), ["duration_s=5"])
    assert (scenario.title, scenario.world.length_m, scenario.duration_s) == ("A bench", 30.0, 5.0)
    with pytest.raises(ValueError, match="frozen"):
        scenario.sensor.rpm = 300


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
    """A path or pace given by `--set` takes the place of the scene's own, and so does a rotor's phase."""
    motion = load("reference_forest", settings).motion
    assert motion.model_fields_set == own_keys | {"kind"}
    phase = "gps.connected=true", "sensor.start_azimuth_deg=10", "sensor.phase_lock_deg=90"
    sensor = load("static_bench", phase).sensor
    assert (sensor.start_azimuth_deg, sensor.phase_lock_deg) == (None, 90.0)


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


def test_a_scene_is_named_by_its_file(tmp_path):
    """The title is the file's name unless it is given, and a file that is wrong by itself is named, whatever is set."""
    scene = written(tmp_path, WALK.replace('title = "A walk"\n', "") + "stems_per_ha = 500\n")
    assert load(scene).title == "scene"
    assert load(scene.rename(tmp_path / "my_walk.toml")).title == "my_walk"
    scene = written(tmp_path, WALK + "stems_per_ha = 500\n[sensor]\nmin_range_m = 120.0\n")
    with pytest.raises(ScenarioError, match=rf"^{scene}: sensor.max_range_m: found 100.0"):
        load(scene, ["seed=7"])


def test_settings_apply_in_order_and_create_tables(tmp_path):
    """The last setting of a key wins and is the one blamed, bare words are strings, absent tables appear."""
    settings = ["sensor.rpm=300", "sensor.rpm=1200", "sensor.return_mode=dual"]
    scenario = load(str(written(tmp_path, SCENE)), [*settings, "gps.connected=false", "title=two words"])
    assert (scenario.sensor.rpm, scenario.sensor.return_mode) == (1200, "dual")
    assert (scenario.gps.connected, scenario.title) == (False, "two words")
    with pytest.raises(ScenarioError, match=r"^--set sensor\.rpm=2: "):
        load(str(written(tmp_path, SCENE)), ["sensor.rpm=1", "sensor.rpm=2"])


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


@pytest.mark.parametrize("quote", ["", "'", '"'])
def test_start_is_exact_in_nanoseconds(tmp_path, quote):
    """A start time with an offset and microseconds becomes exact UTC nanoseconds, in quotes too."""
    start = f"start_utc={quote}2026-05-20T11:00:00.000001+02:00{quote}"
    scenario = load(str(written(tmp_path, SCENE)), [start])
    assert scenario.start_ns == 1_779_267_600_000_001_000  # `date -d 2026-05-20T09:00:00Z +%s`
    in_file = SCENE.replace("[sensor]", f"{start}\n[sensor]", 1)
    assert load(str(written(tmp_path, in_file))).start_ns == scenario.start_ns


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


BAD_FILES = [
    # text to replace, replacement, the line after "<file>: "
    ("rpm = 600", "rpm = 620", "sensor.rpm: found 620; expected a whole number from 300 to 1200 in steps of 60"),
    ("rpm = 600", 'rpm = "fast"', 'sensor.rpm: found "fast"; expected a whole number from 300 to 1200 in steps of 60'),
    ("rpm = 600", "rmp = 600", "sensor.rmp: unknown key; expected rpm, the nearest known one"),
    ("title", "titel", "titel: unknown key; expected title, the nearest known one"),
    ("schema = 1", "", "schema: missing; expected 1"),
    ("schema = 1", "schema = 1\nseed = -1", "seed: found -1; expected a whole number at least 0 and below 9223372036854775808"),
    ('kind = "static"', 'kind = "run"', 'motion.kind: found "run"; expected "live", "recorded", "static" or "walk"'),
    ('kind = "static"', "", 'motion.kind: missing; expected "live", "recorded", "static" or "walk"'),
    ('kind = "static"', 'kind = "static"\nspeed = 1.0', "motion.speed: unknown key; expected one of mount, kind, x_m, y_m, height_m, yaw_deg, pitch_deg, roll_deg"),
    ("length_m = 30", "length_m = 0", "world.length_m: found 0; expected a number from 0.001 to 10000"),
    ("length_m = 30", "length_m = inf", "world.length_m: found inf; expected a finite number from 0.001 to 10000"),
    ("height_m = 6.0", 'height_m = 6.0\npoles = [{ name = "p", foot_m = [0, 0], diameter_m = 1, height_m = 1 }]', "world.poles[0].foot_m[2]: missing; expected a number"),
    ("[motion]", "[gps]\nconnected = 1\n[motion]", "gps.connected: found 1; expected true or false"),
    ("[sensor]\nrpm = 600", "sensor = 600", 'sensor: found 600; expected a table with model = "free", "puck-hi-res", "puck-lite" or "vlp-16"'),
    ("rpm = 600", "min_range_m = 20.0\nmax_range_m = 10.0", "sensor.max_range_m: found 10.0; expected more than min_range_m = 20.0"),
    ('title = "A bench"', 'title = "A bench"\nstart_utc = 2026-05-20T09:00:00', "start_utc: found 2026-05-20T09:00:00; expected a date and time with its offset from UTC, such as 2026-05-20T09:00:00Z"),
]  # fmt: skip

BAD_SETTINGS = [
    ("sensor.rpm=250", "--set sensor.rpm=250: found 250; expected a whole number from 300 to 1200 in steps of 60"),
    ("sensor.rpm", "--set sensor.rpm: no assignment; expected key.path=value"),
    ("sensor.rpm=", "--set sensor.rpm=: no assignment; expected key.path=value"),
    ("=3", "--set =3: no assignment; expected key.path=value"),
    ("title.short=x", "--set title.short=x: title is no table; expected table names before the last dot"),
    ("duration_s=-1", "--set duration_s=-1: found -1; expected a number above 0 and at most 604800"),
    ('motion.kind=["walk"]', '--set motion.kind=["walk"]: found a list of 1; expected "live", "recorded", "static" or "walk"'),
    *((f"start_utc={t}", f"--set start_utc={t}: found {t}; expected a time from 1970 to 2105, as captures can be stamped with") for t in ("1970-01-01T00:00:00+00:01", "2105-12-31T23:59:59-01:00")),
    ("gps.wander_s=0.9", "--set gps.wander_s=0.9: found 0.9; expected a number from 1 to 1000000"),
    ("motion.way_points_m=[[0, 0], [nan, 1]]", "--set motion.way_points_m=[[0, 0], [nan, 1]]: motion.way_points_m[1][0]: found nan; expected a finite number"),
    ("motion.way_points_m=[[0, 0], [1, 2, 3]]", "--set motion.way_points_m=[[0, 0], [1, 2, 3]]: motion.way_points_m[1]: found a list of 3; expected a list of 2 numbers"),
    *((f"world.near_m={found}", f"--set world.near_m={found}: found {found}; expected a number at least 5") for found in ("4.9", '"far"')),
    ("motion=3", '--set motion=3: found 3; expected a table with kind = "live", "recorded", "static" or "walk"'),
    ("world.species=[]", "--set world.species=[]: found a list of 0; expected a list of at least 1"),
    ("rpm=1200", "--set rpm=1200: unknown key; expected sensor.rpm"),
    ("gait=strong", "--set gait=strong: unknown key; expected motion.gait"),
    ("sensor.beams=64", ('--set sensor.beams=64: unknown key; expected sensor.model = "free" beside it, with elevations_deg, beams, ' "vertical_fov_deg, azimuth_resolution_deg, lens_radius_m")),
    ("motion.yaw_deg=3", '--set motion.yaw_deg=3: unknown key; expected motion.kind = "recorded" or "static" beside it'),
    ("motion.gait=fast", '--set motion.gait=fast: motion.gait.preset: found "fast"; expected "none", "paper", "natural" or "strong"'),
    ("world=old_growth", '--set world=old_growth: found "old_growth"; expected a table, as by world.preset = "old_growth"'),
    ("beam=fixed", '--set beam=fixed: found "fixed"; expected a table, as by beam.model = "fixed"'),
    ("sensor.data_port=8308", "--set sensor.data_port=8308: sensor: found a table; expected a data_port and a position_port that differ"),
    ("sensor.min_range_m=120", "--set sensor.min_range_m=120: sensor.max_range_m: found 100.0; expected more than min_range_m = 120.0"),
    ("world={kind='hall'}", "--set world={kind='hall'}: world.length_m, world.width_m, world.height_m: missing; expected world.length_m = a number from 0.001 to 10000, world.width_m = a number from 0.001 to 10000, world.height_m = a number from 0.001 to 10000"),
    ("seed=1\ntitle='x'", "--set seed=1\\ntitle='x': found \"1\\ntitle='x'\"; expected a whole number at least 0 and below 9223372036854775808"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "line"), BAD_FILES, ids=[row[2][:50] for row in BAD_FILES])
def test_a_bad_file_is_reported_in_one_line(tmp_path, old, new, line):
    """A bad scene file gives the file, the key path, what was found and what was expected, in these words."""
    assert SCENE.count(old) == 1
    path = written(tmp_path, SCENE.replace(old, new))
    with pytest.raises(ScenarioError) as caught:
        load(str(path))
    assert str(caught.value) == f"{path}: {line}"


@pytest.mark.parametrize(("setting", "line"), BAD_SETTINGS, ids=[row[0] for row in BAD_SETTINGS])
def test_a_bad_setting_is_reported_in_one_line(tmp_path, setting, line):
    """A bad setting is named as it was given, not blamed on the file."""
    with pytest.raises(ScenarioError) as caught:
        load(str(written(tmp_path, WALK)), [setting])
    assert str(caught.value) == line


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"a = = 1", "no valid TOML: Invalid value (at line 1, column 5); expected a TOML file"),
        (b"\xff\xfe", "no UTF-8 text at byte 0; expected a scene file"),
        (b"seed = " + b"9" * 5000, "no valid TOML: Exceeds the limit (4300 digits)"),
        (b"\nseed = 0x" + b"f" * 5000, "no valid TOML: too long a number (at line 2)"),
        (b"seed = " + b"[" * 5000, "no valid TOML: maximum recursion depth exceeded"),
        (
            b"seed = 1\n" + b"a." * 100_000 + b"a = 1",
            "no valid TOML: a key with more than 100 names (at line 2)",
        ),
        (b'[ "a\\""' + b" . b" * 100_000 + b"]", "no valid TOML: a key with more than 100 names (at line 1)"),
        (
            b"x = { " + b"'a'." * 100_000 + b"a = 1 }",
            "no valid TOML: a key with more than 100 names (at line 1)",
        ),
        (b"x = " + b"[" * 150 + b"]" * 150, "tables or lists in one another, 100 deep; expected the tables"),
        (
            b"x = " + b"{a=" * 120 + b"1" + b"}" * 120,
            "tables or lists in one another, 100 deep; expected the",
        ),
    ],
    ids=[
        "syntax",
        "encoding",
        "integer",
        "hex",
        "nesting",
        "key",
        "table",
        "inline",
        "deep lists",
        "deep tables",
    ],
)
def test_a_file_that_is_no_toml_is_reported(tmp_path, content, said):
    """A file that the TOML parser refuses, for whatever reason, gives one error with its place."""
    path = tmp_path / "scene.toml"
    path.write_bytes(content)
    with pytest.raises(ScenarioError) as caught:
        load(str(path))
    assert str(caught.value).startswith(f"{path}: {said}")


@pytest.mark.parametrize("depth", [150, 700, 100_000])
def test_json_is_no_deeper_than_a_scene(tmp_path, depth):
    """Lists in one another are refused in a line, however many they are, and in a dictionary too."""
    path = tmp_path / "scene.json"
    path.write_text('{"x": ' + "[" * depth + "]" * depth + "}")
    with pytest.raises(ScenarioError, match=r"100 deep; expected|no valid JSON: maximum recursion depth"):
        load(str(path))
    tree = {}
    for _ in range(depth):
        tree = {"x": tree}
    with pytest.raises(ScenarioError, match="scene: tables or lists in one another, 100 deep"):
        load(tree)


def test_half_a_character_in_json_is_refused(tmp_path):
    """An escape that makes no character is named, and nothing else of the file is shown."""
    path = tmp_path / "scene.json"
    path.write_text('{"schema": 1, "title": "secret \\ud800"}')
    with pytest.raises(ScenarioError) as caught:
        load(str(path))
    assert str(caught.value) == f"{path}: found '\\ud800'; expected text in Unicode"


@pytest.mark.parametrize(
    "setting", ["a." * 100_000 + "a=1", "seed={" + "a." * 100_000 + "a=1}", "seed=" + "[" * 5000]
)
def test_a_setting_is_no_deeper_than_a_scene(tmp_path, setting):
    """A key of 100 000 names, and a value of as many, are refused in a line of bounded length."""
    with pytest.raises(ScenarioError) as caught:
        load(str(written(tmp_path, SCENE)), [setting])
    assert str(caught.value).startswith(f"--set {setting[:60]}")
    assert len(str(caught.value)) < 2500


def test_many_points_on_a_line_are_no_deep_key(tmp_path):
    """A thousand coordinates on one line are read as before."""
    points = ", ".join(f"[{i}.5, {i}.25]" for i in range(1000))
    settings = ["motion.kind='walk'", f"motion.way_points_m=[{points}]"]
    with pytest.raises(ScenarioError) as caught:
        load(str(written(tmp_path, SCENE)), [*settings, "seed=-1"])
    assert "seed" in str(caught.value)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("none.toml", "no such file or directory"),
        ("folder.toml", "is a directory"),
        ("x" * 300 + ".toml", "file name too long"),
    ],
)
def test_a_file_that_cannot_be_read_is_reported(tmp_path, name, said):
    """A path that leads to no readable file gives the operating system's reason."""
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(ScenarioError) as caught:
        load(str(tmp_path / name))
    assert str(caught.value) == f"{tmp_path / name}: {said}; expected a scene file"

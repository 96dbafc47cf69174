"""What is said about scene files and settings that are none."""

from pathlib import Path

import pytest

from vlp16emu.errors import ScenarioError
from vlp16emu.scenario import load

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


BAD_FILES = [
    # text to replace, replacement, the line after "<file>: "
    ("rpm = 600", "rpm = 250", "sensor.rpm: found 250; expected a whole number from 300 to 1200 in steps of 60"),
    ("rpm = 600", "rpm = 620", "sensor.rpm: found 620; expected a whole number from 300 to 1200 in steps of 60"),
    ("rpm = 600", 'rpm = "fast"', 'sensor.rpm: found "fast"; expected a whole number from 300 to 1200 in steps of 60'),
    ("rpm = 600", "rpm = true", "sensor.rpm: found true; expected a whole number from 300 to 1200 in steps of 60"),
    ("rpm = 600", "data_port = 8308", "sensor: found a table; expected a data_port and a position_port that differ"),
    ("rpm = 600", "rmp = 600", "sensor.rmp: unknown key; expected rpm, the nearest known one"),
    ("title", "titel", "titel: unknown key; expected title, the nearest known one"),
    ("schema = 1", "", "schema: missing; expected 1"),
    ("schema = 1", "schema = 2", "schema: found 2; expected 1"),
    (
        "schema = 1",
        "schema = 1\nseed = -1",
        "seed: found -1; expected a whole number at least 0 and below 9223372036854775808",
    ),
    ('kind = "static"', 'kind = "run"', 'motion.kind: found "run"; expected "live", "recorded", "static" or "walk"'),
    ('kind = "static"', "", 'motion.kind: missing; expected "live", "recorded", "static" or "walk"'),
    (
        'kind = "static"',
        'kind = "static"\nspeed = 1.0',
        "motion.speed: unknown key; expected one of kind, x_m, y_m, height_m, yaw_deg, pitch_deg, roll_deg, mount",
    ),
    ("length_m = 30", "length_m = 0", "world.length_m: found 0; expected a number from 0.001 to 10000"),
    ("length_m = 30", "length_m = inf", "world.length_m: found inf; expected a finite number from 0.001 to 10000"),
    ("length_m = 30", "", "world.length_m: missing; expected a number from 0.001 to 10000"),
    (
        "height_m = 6.0",
        "height_m = 6.0\nwall_reflectance = 1.5",
        "world.wall_reflectance: found 1.5; expected a number from 0 to 1",
    ),
    (
        "height_m = 6.0",
        'height_m = 6.0\npoles = [{ name = "p", foot_m = [0, 0], diameter_m = 1, height_m = 1 }]',
        "world.poles[0].foot_m[2]: missing; expected a number",
    ),
    ("[motion]", "[gps]\nconnected = 1\n[motion]", "gps.connected: found 1; expected true or false"),
    (
        "[sensor]\nrpm = 600",
        "sensor = 600",
        'sensor: found 600; expected a table with model = "free", "puck-hi-res", "puck-lite" or "vlp-16"',
    ),
    (
        "rpm = 600",
        "min_range_m = 20.0\nmax_range_m = 10.0",
        "sensor.max_range_m: found 10.0; expected more than min_range_m = 20.0",
    ),
    ("rpm = 600", "min_range_m = 120.0", "sensor.max_range_m: found 100.0; expected more than min_range_m = 120.0"),
    (
        'title = "A bench"',
        'title = "A bench"\nstart_utc = 2026-05-20T09:00:00',
        (
            "start_utc: found 2026-05-20T09:00:00; expected a date and time with its offset from UTC, "
            "such as 2026-05-20T09:00:00Z"
        ),
    ),
    ("rpm = 600", 'return_mode = "both"', 'sensor.return_mode: found "both"; expected "strongest", "last" or "dual"'),
]

BAD_SETTINGS = [
    ("sensor.rpm=250", "--set sensor.rpm=250: found 250; expected a whole number from 300 to 1200 in steps of 60"),
    ("sensor.rpm", "--set sensor.rpm: no assignment; expected key.path=value"),
    ("sensor.rpm=", "--set sensor.rpm=: no assignment; expected key.path=value"),
    ("=3", "--set =3: no assignment; expected key.path=value"),
    ("title.short=x", "--set title.short=x: title is no table; expected table names before the last dot"),
    ("duration_s=-1", "--set duration_s=-1: found -1; expected a number above 0 and at most 604800"),
    (
        "sensor.powered_for_s=1e300",
        "--set sensor.powered_for_s=1e300: found 1e+300; expected a number from 0 to 1000000000",
    ),
    *(
        (f"gps.{key}={found}", f"--set gps.{key}={found}: found {found}; expected a number from {bounds}")
        for key, found, bounds in (
            ("position_noise_m", 1000.1, "0 to 1000"),
            ("wander_m", 1000.1, "0 to 1000"),
            ("wander_s", 0.9, "1 to 1000000"),
            ("velocity_noise_m_s", 100.1, "0 to 100"),
            ("canopy_error_factor", 100.1, "1 to 100"),
            ("antenna_above_m", 100.1, "0 to 100"),
        )
    ),
    (
        "motion.way_points_m=[[0, 0], [nan, 1]]",
        "--set motion.way_points_m=[[0, 0], [nan, 1]]: motion.way_points_m[1][0]: found nan; expected a finite number",
    ),
    (
        "motion.way_points_m=[[0, 0], [1, 2, 3]]",
        (
            "--set motion.way_points_m=[[0, 0], [1, 2, 3]]: motion.way_points_m[1]: found a list of 3; "
            "expected a list of 2 numbers"
        ),
    ),
    *(
        (f"world.near_m={found}", f"--set world.near_m={found}: found {found}; expected a number at least 5")
        for found in ("4.9", "nan", '"far"')
    ),
    ("motion=3", '--set motion=3: found 3; expected a table with kind = "live", "recorded", "static" or "walk"'),
    ("world.species=[]", "--set world.species=[]: found a list of 0; expected a list of at least 1"),
    ("rpm=1200", "--set rpm=1200: unknown key; expected sensor.rpm"),
    ("gait=strong", "--set gait=strong: unknown key; expected motion.gait"),
    (
        "sensor.beams=64",
        (
            '--set sensor.beams=64: unknown key; expected sensor.model = "free" beside it, with elevations_deg, beams, '
            "vertical_fov_deg, azimuth_resolution_deg, lens_radius_m"
        ),
    ),
    (
        "motion.yaw_deg=3",
        '--set motion.yaw_deg=3: unknown key; expected motion.kind = "recorded" or "static" beside it',
    ),
    (
        "motion.gait=fast",
        '--set motion.gait=fast: motion.gait.preset: found "fast"; expected "none", "paper", "natural" or "strong"',
    ),
    (
        "world=old_growth",
        '--set world=old_growth: found "old_growth"; expected a table, as by world.preset = "old_growth"',
    ),
    ("beam=fixed", '--set beam=fixed: found "fixed"; expected a table, as by beam.model = "fixed"'),
    (
        "sensor.rpm=600.5",
        "--set sensor.rpm=600.5: found 600.5; expected a whole number from 300 to 1200 in steps of 60",
    ),
    (
        "sensor.data_port=8308",
        "--set sensor.data_port=8308: sensor: found a table; expected a data_port and a position_port that differ",
    ),
    (
        "sensor.min_range_m=120",
        "--set sensor.min_range_m=120: sensor.max_range_m: found 100.0; expected more than min_range_m = 120.0",
    ),
    (
        "world={kind='hall'}",
        (
            "--set world={kind='hall'}: world.length_m, world.width_m, world.height_m: missing; expected "
            "world.length_m = a number from 0.001 to 10000, world.width_m = a number from 0.001 to 10000, "
            "world.height_m = a number from 0.001 to 10000"
        ),
    ),
    (
        "seed=1\ntitle='x'",
        "--set seed=1\\ntitle='x': found \"1\\ntitle='x'\"; expected a whole number at least 0 and below 9223372036854775808",
    ),
]


def written(folder: Path, text: str) -> Path:
    path = folder / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return path


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
        (b"seed = " + b"[" * 5000, "no valid TOML: maximum recursion depth exceeded"),
        (b"seed = 1\n" + b"a." * 100_000 + b"a = 1", "no valid TOML: a key with more than 100 names (at line 2)"),
        (b'[ "a\\""' + b" . b" * 100_000 + b"]", "no valid TOML: a key with more than 100 names (at line 1)"),
        (b"x = { " + b"'a'." * 100_000 + b"a = 1 }", "no valid TOML: a key with more than 100 names (at line 1)"),
        (b"x = " + b"[" * 150 + b"]" * 150, "tables or lists in one another, 100 deep; expected the tables"),
        (b"x = " + b"{a=" * 120 + b"1" + b"}" * 120, "tables or lists in one another, 100 deep; expected the"),
    ],
    ids=["syntax", "encoding", "integer", "nesting", "key", "table", "inline", "deep lists", "deep tables"],
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


@pytest.mark.parametrize("setting", ["a." * 100_000 + "a=1", "seed={" + "a." * 100_000 + "a=1}", "seed=" + "[" * 5000])
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

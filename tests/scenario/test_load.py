"""Scene files: what is read, and what is said about files that are none."""

from pathlib import Path

import dpkt
import pytest

from vlp16emu.errors import ScenarioError
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
    """A mark of UTF-8 is no fault, `length_m = 30` is 30.0, and a scenario cannot be changed once it is
    read."""
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
    """Words in any case, whole numbers with a point, and a preset's name for its table are what they stand
    for."""
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
    """The title is the file's name unless it is given, and a file that is wrong by itself is named,
    whatever is set."""
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
    assert str(caught.value) == f"{path}: no valid JSON: '\\ud800' is half a character; expected a JSON file"


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

"""Configurations of SLAM programs: those in protocol/slam, read by loaders of their formats, and their names held against the sources."""

import json
import re
import shutil
import struct
import subprocess
import tomllib
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vlp16emu.extras.slam.configure import Rig, configurations, programs
from vlp16emu.extras.slam.fitness import ROWS

NAMES = tomllib.loads(Path(__file__).with_name("slam_names.toml").read_text(encoding="utf-8"))
FILES = [(program, file) for program in programs().values() for file in program.files]
YAML = [(program, file) for program, file in FILES if file.name.endswith(".yaml")]


def yaml_of(text):
    yaml = pytest.importorskip("yaml", reason="PyYAML is not installed")
    return yaml.safe_load(text)


def leaves(tree, path=""):
    """Values by the path of their keys."""
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from leaves(value, f"{path}{key}/")
        else:
            yield f"{path}{key}", value


def test_the_folder_is_made_of_the_table(protocol, tool_named):
    """Every file of protocol/slam is what the table makes, and there is no other."""
    there = {path.name: path.read_text(encoding="utf-8") for path in (protocol / "slam").iterdir()}
    assert there == tool_named("slam_files").made()


@pytest.mark.parametrize("program", programs().values(), ids=str)
def test_names_are_those_of_the_source(program):
    """No parameter has a name that its program does not read: such a value would be ignored without a word."""
    unknown = {value.key for file in program.files for value in file.values} - set(
        NAMES[program.name]["names"]
    )
    assert not unknown


@pytest.mark.parametrize("program", programs().values(), ids=str)
def test_needs_are_rules(program):
    """Each need of a program is a rule of the fitness check, and says what happens otherwise."""
    assert set(program.needs) <= {row.rule for row in ROWS}
    assert all(text.count("; ") >= 1 for text in program.needs.values())


@pytest.mark.parametrize(("program", "file"), YAML, ids=str)
def test_yaml_reads_as_written(program, file):
    """A loader of YAML finds each key under its root, numbers as numbers and texts as texts."""
    tree = yaml_of(configurations(program, Rig())[file.name])
    for part in filter(None, file.root.split("/")):
        tree = tree[part]
    found = dict(leaves(tree))
    assert list(found) == [value.key for value in file.values]
    for value in file.values:
        if not (isinstance(value.value, str) and value.value.startswith("{")):
            assert found[value.key] == value.value
            assert type(found[value.key]) is type(value.value)


def test_json_reads_as_written():
    """GLIM's files are JSON without comments."""
    texts = configurations(programs()["glim"], Rig())
    assert json.loads(texts["glim_ros.json"])["glim_ros"]["points_topic"] == "/velodyne_points"
    assert json.loads(texts["glim_sensors.json"])["sensors"]["T_lidar_imu"] == [0, 0, 0, 0, 0, 0, 1]


def test_lua_reads_as_written(tmp_path):
    """A Lua interpreter that has Cartographer's tables runs the file, and finds our values in what it returns and sets."""
    tshark = shutil.which("tshark")
    if not tshark:
        pytest.skip("tshark, which brings Lua, is not installed")
    text = configurations(programs()["cartographer"], Rig())["cartographer.lua"]
    (tmp_path / "probe.lua").write_text(
        "included = 0; function include(name) included = included + 1 end\n"
        "function tables() return setmetatable({}, {__index = function(t, k) rawset(t, k, tables()); return rawget(t, k) end}) end\n"
        "MAP_BUILDER, TRAJECTORY_BUILDER, TRAJECTORY_BUILDER_3D, POSE_GRAPH = {}, {}, {}, tables()\n"
        f"local function configuration()\n{text}end\n"
        "local options = configuration()\n"
        "print('found', included, options.tracking_frame, options.num_point_clouds, options.map_builder == MAP_BUILDER,\n"
        "      TRAJECTORY_BUILDER_3D.num_accumulated_range_data, POSE_GRAPH.constraint_builder.min_score)\n"
    )
    (tmp_path / "empty.pcap").write_bytes(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1))
    command = [tshark, "-X", f"lua_script:{tmp_path / 'probe.lua'}", "-r", str(tmp_path / "empty.pcap")]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "found\t2\timu\t1\ttrue\t1\t0.62" in ran.stdout, ran.stderr


@pytest.mark.parametrize("name", ["a-loam", "lego-loam", "hdl-graph-slam"])
def test_launch_files_read_as_written(name):
    """A launch file is XML: remaps stand before the launch file that they hold for, parameters behind it, where the last value holds."""
    (text,) = configurations(programs()[name], Rig(rpm=300.0)).values()
    root = ET.fromstring(text)
    kinds = [child.tag for child in root]
    assert kinds == sorted(kinds, key=["remap", "include", "param"].index)
    (include,) = root.findall("include")
    assert re.fullmatch(r"\$\(find \w+\)/launch/\w+\.launch", include.get("file"))
    written = [
        f"{child.tag}/{child.get('from') or child.get('name')}" for child in root if child.tag != "include"
    ]
    assert set(written) <= set(NAMES[name]["names"])
    assert written


def test_shell_sets_what_mola_reads(tmp_path):
    """Sourced by a shell, the file sets MOLA's variables."""
    (tmp_path / "mola.sh").write_text(configurations(programs()["mola"], Rig())["mola.sh"])
    shell = shutil.which("sh")
    if not shell:
        pytest.skip("there is no shell")
    ran = subprocess.run(
        [shell, "-c", ". ./mola.sh; env"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert {"MOLA_LIDAR_TOPIC=/velodyne_points", "MOLA_GNSS_TOPIC=/fix"} <= set(ran.stdout.splitlines())


def pose(place_m, euler_deg):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_euler("zyx", euler_deg, degrees=True).as_matrix(), place_m
    return T


def test_extrinsics_have_the_direction_that_each_program_wants():
    """A point that the lidar sees is at the same place for all of them.

    FAST-LIO2 has the lidar in the unit's frame, LIO-SAM and GLIM the unit in the lidar's, DLIO both in the body's, RKO-LIO the
    unit in its base, the lidar.
    """
    base_T_lidar, base_T_imu = pose((0.1, -0.2, 0.5), (30, 5, -8)), pose((-0.05, 0.02, 0.1), (-90, 0, 3))
    imu = {"rate_hz": 100, "accel_noise_m_s2_sqrt_hz": 1.2e-3, "gyro_noise_rad_s_sqrt_hz": 0.0}
    rig = Rig(300.0, base_T_lidar, base_T_imu, imu, "unit_1/velodyne")
    made = {
        name: configurations(programs()[name], rig)
        for name in ("fast-lio2", "point-lio", "lio-sam", "dlio", "rko-lio", "glim")
    }
    seen = np.array([4.0, -3.0, 2.0])
    in_base = base_T_lidar[:3, :3] @ seen + base_T_lidar[:3, 3]
    in_imu = base_T_imu[:3, :3].T @ (in_base - base_T_imu[:3, 3])
    for name in ("fast-lio2", "point-lio"):
        mapping = yaml_of(made[name][f"{name}.yaml"])["mapping"]
        np.testing.assert_allclose(
            np.reshape(mapping["extrinsic_R"], (3, 3)) @ seen + mapping["extrinsic_T"], in_imu, atol=1e-7
        )
    lio = yaml_of(made["lio-sam"]["lio-sam.yaml"])["lio_sam"]
    np.testing.assert_allclose(
        np.reshape(lio["extrinsicRot"], (3, 3)) @ in_imu + lio["extrinsicTrans"], seen, atol=1e-7
    )
    assert (lio["Horizon_SCAN"], lio["pointCloudTopic"], lio["lidarFrame"]) == (
        3600,
        "/unit_1/velodyne_points",
        "unit_1/velodyne",
    )
    assert (lio["imuAccNoise"], lio["imuGyrNoise"]) == (1.2e-3, 1.5636343949698187e-03)
    body = yaml_of(made["dlio"]["dlio.yaml"])["dlio"]["extrinsics"]
    for device, point in (("lidar", seen), ("imu", in_imu)):
        mount = body[f"baselink2{device}"]
        np.testing.assert_allclose(np.reshape(mount["R"], (3, 3)) @ point + mount["t"], in_base, atol=1e-7)
    rko = yaml_of(made["rko-lio"]["rko-lio.yaml"])["extrinsic_imu2base_quat_xyzw_xyz"]
    np.testing.assert_allclose(Rotation.from_quat(rko[:4]).apply(in_imu) + rko[4:], seen, atol=1e-7)
    glim = json.loads(made["glim"]["glim_sensors.json"])["sensors"]["T_lidar_imu"]
    np.testing.assert_allclose(Rotation.from_quat(glim[3:]).apply(in_imu) + glim[:3], seen, atol=1e-7)
    assert yaml_of(made["point-lio"]["point-lio.yaml"])["mapping"]["imu_time_inte"] == 0.01
    assert yaml_of(made["point-lio"]["point-lio.yaml"])["mapping"]["lidar_time_inte"] == 0.2

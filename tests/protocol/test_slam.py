"""Configurations of SLAM programs, read by loaders of their formats; their names are held against the
sources."""

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

from vlp16emu.errors import InputError
from vlp16emu.extras.slam.configure import Rig, configurations, programs
from vlp16emu.extras.slam.fitness import ROWS
from vlp16emu.types import SensorModel

NAMES = tomllib.loads(Path(__file__).with_name("slam_names.toml").read_text(encoding="utf-8"))
VALUES = tomllib.loads(Path(__file__).with_name("slam_values.toml").read_text(encoding="utf-8"))
KINDS = {
    "bool": lambda value: isinstance(value, bool),
    "int": lambda value: isinstance(value, int) and not isinstance(value, bool),
    "double": lambda value: isinstance(value, float),
    "string": lambda value: isinstance(value, str),
    "doubles": lambda value: isinstance(value, list) and all(isinstance(number, float) for number in value),
}
"""What a node of ROS 2 takes for a parameter of each type: rclcpp refuses a whole number for a double."""
PROGRAM_OF = {name: program for program in programs().values() for name in program.files}
FILES = [(program, name) for program in programs().values() for name in program.files]


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


def pose(place_m, euler_deg):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_euler("zyx", euler_deg, degrees=True).as_matrix(), place_m
    return T


def values_of(name, rig):
    """Values of a YAML file by name, as its node reads it."""
    read = dict(leaves(yaml_of(configurations(PROGRAM_OF[name], rig)[name])))
    return {path.removeprefix("/**/ros__parameters/"): value for path, value in read.items()}


def odd_rig():
    """A rig in which no number is one of a default."""
    imu = {"rate_hz": 100, "accel_noise_m_s2_sqrt_hz": 1e-3, "gyro_noise_rad_s_sqrt_hz": 1e-5}
    return Rig(300.0, pose((0, 0, 1), (30, 5, -8)), pose((0, 0, -2), (-90, 0, 0)), imu, "unit_1/velodyne")


def keys_of(name, text):
    """Paths of the parameters in a file, read by a loader of its format."""
    match name.rpartition(".")[2]:
        case "yaml":
            return list(dict(leaves(yaml_of(text))))
        case "json":
            return list(dict(leaves(json.loads(text))))
        case "launch":
            elements = [element for element in ET.fromstring(text) if element.tag != "include"]
            return [f"{element.tag}/{element.get('from') or element.get('name')}" for element in elements]
        case "sh":
            return re.findall(r"^export (\w+)=", text, re.MULTILINE)
        case "lua":
            inside, _, behind = text.partition("\n}\n")
            options = [f"options/{key}" for key in re.findall(r"^  (\w+) = ", inside, re.MULTILINE)]
            return options + re.findall(r"^([\w.]+) = ", behind, re.MULTILINE)


def test_the_folder_is_filled_from_the_templates(protocol, tool_named):
    """Each file of protocol/slam is a template filled for the default rig, there is no other, and the page
    links all."""
    there = {path.name: path.read_text(encoding="utf-8") for path in (protocol / "slam").iterdir()}
    page = there.pop("README.md")
    assert there == tool_named("slam_files").made()
    assert set(re.findall(r"\]\(([\w.-]+)\)", page)) == set(there)
    assert re.findall(r"^\| \[([\w-]+)\]\(https", page, re.MULTILINE) == list(programs())


@pytest.mark.parametrize(("program", "name"), FILES, ids=str)
def test_names_are_those_of_the_source(program, name):
    """A loader reads each file, and no parameter has a name that its program does not read, which it would
    ignore."""
    rows = NAMES[program.name]
    keys = keys_of(name, configurations(program, Rig(300.0))[name])
    known = {f"{root}{key}" for root in rows.get("roots", [""]) for key in rows["names"]}
    if name in VALUES:
        declared = [key for kind in KINDS for key in VALUES[name].get(kind, [])]
        known = {f"/**/ros__parameters/{key}" for key in declared} or known | set(VALUES[name]["values"])
    assert keys
    assert not set(keys) - known


@pytest.mark.parametrize("name", [name for name in VALUES if "types_source" in VALUES[name]])
def test_types_are_those_that_a_node_declares(name):
    """Each value has the type of its parameter, for any rig, and no parameter of the node is missing."""
    kinds = {key: kind for kind in KINDS for key in VALUES[name].get(kind, [])}
    for rig in (Rig(), odd_rig()):
        values = values_of(name, rig)
        assert {key: value for key, value in values.items() if not KINDS[kinds[key]](value)} == {}
        assert set(values) == set(kinds)


@pytest.mark.parametrize(
    ("model", "rings", "columns"), [("vlp-32c", 32, 1800), ("hdl-32e", 32, 2160), ("vls-128", 128, 1867)]
)
def test_rings_and_columns_are_those_of_the_model(model, rings, columns):
    """A program that sorts points by ring or by column gets as many as the model has at 600 rpm."""
    rig = Rig(model=SensorModel(model))
    for program, name in (("lio-sam", "N_SCAN"), ("fast-lio2", "scan_line"), ("point-lio", "scan_line")):
        texts = configurations(programs()[program], rig).values()
        found = [re.findall(rf"^ *{name}: (\d+)", text, re.MULTILINE) for text in texts]
        assert [int(value) for values in found for value in values] == [rings] * len(found) != []
    text = configurations(programs()["lio-sam"], rig)["lio-sam.yaml"]
    assert re.findall(r"Horizon_SCAN: (\d+)", text) == [str(columns)]


@pytest.mark.parametrize("name", VALUES)
def test_a_file_has_all_that_it_replaces(name):
    """Copied over the program's own file, ours loses none of its parameters."""
    assert set(VALUES[name]["values"]) - set(values_of(name, Rig())) == set()


@pytest.mark.parametrize("name", VALUES)
@pytest.mark.parametrize("rig", [Rig(), odd_rig()], ids=["default", "odd"])
def test_each_value_that_differs_has_its_remark(name, rig):
    """A line has a remark with the program's own value if ours is another, and else none."""
    own = VALUES[name]["values"]
    differ = [
        (key.rpartition("/")[2], own[key])
        for key, value in values_of(name, rig).items()
        if key in own and value != own[key]
    ]
    lines = configurations(PROGRAM_OF[name], rig)[name].splitlines()
    remarks = [line.partition("its own value is ") for line in lines if "its own value is" in line]
    noted = [
        (text.partition(":")[0].strip().rpartition("/")[2], yaml_of(value)) for text, _, value in remarks
    ]
    missing = {key for key, _ in noted} - {key.rpartition("/")[2] for key in own}
    assert missing <= {"scan_rate"}  # which Point-LIO's file does not have
    assert sorted(map(str, differ)) == sorted(str(one) for one in noted if one[0] not in missing)


@pytest.mark.parametrize(
    ("usual", "of_ros2"), [(name.replace("_ros2", ""), name) for name in VALUES if "ros2" in name]
)
def test_files_of_both_systems_say_the_same(usual, of_ros2):
    """What a program reads on ROS 1 and on ROS 2 has one value; its own files differ in the field of view."""
    root = re.compile("^(dlio|lio_sam)/")
    first = {root.sub("", key): value for key, value in values_of(usual, odd_rig()).items()}
    second = values_of(of_ros2, odd_rig())
    assert {key for key in first.keys() & second.keys() if first[key] != second[key]} <= {
        "mapping/fov_degree"
    }


def test_frames_of_glim_are_one_tree_with_and_without_a_bag():
    """GLIM finds its base without /tf_static, which glim_rosbag does not read, and beside a played bag no
    frame has a second parent.

    It sends map to odom, odom to its base and its IMU to its lidar, and looks its base up from the IMU if
    they are not one frame (koide3/glim_ros2 13a6bcb26e176144f65b6ecd221edfebd0a36a66,
    src/glim_ros/rviz_viewer.cpp, odometry_new_frame).
    """
    glim = json.loads(configurations(programs()["glim"], Rig())["glim_ros.json"])["glim_ros"]
    imu = glim["imu_frame_id"]
    assert imu == glim["base_frame_id"]
    sent = [("map", "odom"), ("odom", imu), (imu, glim["lidar_frame_id"])]
    of_bag = [("base_link", frame) for frame in ("velodyne", "imu", "gps", "camera_optical_frame")]
    of_bag.append(("map", "base_link_truth"))
    children = [child for _, child in sent + of_bag]
    assert len(children) == len(set(children))


def test_the_page_lists_the_values_of_json(protocol):
    """JSON has no remarks: the page has a row for each value that differs, with ours."""
    page = (protocol / "slam" / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (glim_\w+\.json) \| `(\w+)` \| (.*?) \| (.*?) \|", page, re.MULTILINE)
    made = configurations(programs()["glim"], Rig())
    assert rows
    for name, key, ours, its in rows:
        (section,) = json.loads(made[name]).values()
        assert ours == (section[key] if isinstance(section[key], str) else json.dumps(section[key]))
        assert ours != its


@pytest.mark.parametrize(("program", "name"), FILES, ids=str)
def test_every_name_of_a_template_has_a_value(program, name):
    """No name of the rig is left in a filled file, also where the rig has no such value."""
    imu = {"rate_hz": 100, "accel_noise_m_s2_sqrt_hz": 0.0}
    for rig in (Rig(), Rig(300.0, imu=imu)):
        assert not re.search(r"\$(?!\(find )", configurations(program, rig)[name])


def test_a_remark_stands_where_a_value_differs():
    """A value that is the program's own has no remark, and no element in a launch file."""
    usual, slow = (
        configurations(programs()["point-lio"], Rig(rpm))["point-lio.yaml"] for rpm in (600.0, 300.0)
    )
    assert "scan_rate: 10\n" in usual
    assert "scan_rate: 5  # revolutions per second; its own value is 10\n" in slow
    usual, slow = (
        configurations(programs()["hdl-graph-slam"], Rig(rpm))["hdl-graph-slam.launch"]
        for rpm in (600.0, 300.0)
    )
    assert "scan_period" not in usual
    assert '<param name="/prefiltering_nodelet/scan_period" value="0.2" />' in slow


@pytest.mark.parametrize("program", programs().values(), ids=str)
def test_needs_are_rules(program):
    """Each need of a program is a rule of the fitness check, and says what happens otherwise."""
    assert set(program.needs) <= {row.rule for row in ROWS}
    assert all(text.count("; ") >= 1 for text in program.needs.values())


def test_numbers_of_yaml_are_numbers():
    """YAML 1.1 reads 1e-9 as a text: the files have 1.0e-9."""
    imu = {"rate_hz": 100, "accel_walk_m_s3_sqrt_hz": 1e-5}
    for program, name in FILES:
        if name.endswith(".yaml"):
            values = dict(leaves(yaml_of(configurations(program, Rig(imu=imu))[name]))).values()
            texts = [value for value in values if isinstance(value, str)]
            assert [text for text in texts if re.fullmatch(r"[-+.e\d]+", text) and text.count(".") < 2] == []


def test_json_reads_as_written():
    """GLIM's files are JSON without comments."""
    texts = configurations(programs()["glim"], Rig())
    assert json.loads(texts["glim_ros.json"])["glim_ros"]["points_topic"] == "/velodyne_points"
    assert json.loads(texts["glim_sensors.json"])["sensors"]["T_lidar_imu"] == [0, 0, 0, 0, 0, 0, 1]


def test_lua_reads_as_written(tmp_path):
    """A Lua interpreter that has Cartographer's tables runs the file, and finds our values in what it
    returns and sets."""
    tshark = shutil.which("tshark")
    if not tshark:
        pytest.skip("tshark, which brings Lua, is not installed")
    text = configurations(programs()["cartographer"], Rig())["cartographer.lua"]
    (tmp_path / "probe.lua").write_text(
        "included = 0; function include(name) included = included + 1 end\n"
        "function tables() return setmetatable({}, {__index = function(t, k) rawset(t, k, tables()); "
        "return rawget(t, k) end}) end\n"
        "MAP_BUILDER, TRAJECTORY_BUILDER, TRAJECTORY_BUILDER_3D, POSE_GRAPH = {}, {}, {}, tables()\n"
        f"local function configuration()\n{text}end\n"
        "local options = configuration()\n"
        "print('found', included, options.tracking_frame, options.num_point_clouds, options.map_builder "
        "== MAP_BUILDER,\n"
        "      TRAJECTORY_BUILDER_3D.num_accumulated_range_data, POSE_GRAPH.constraint_builder.min_score)\n"
    )
    (tmp_path / "empty.pcap").write_bytes(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1))
    command = [tshark, "-X", f"lua_script:{tmp_path / 'probe.lua'}", "-r", str(tmp_path / "empty.pcap")]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "found\t2\timu\t1\ttrue\t1\t0.62" in ran.stdout, ran.stderr


@pytest.mark.parametrize("name", ["a-loam", "lego-loam", "hdl-graph-slam"])
def test_launch_files_read_as_written(name):
    """A launch file is XML: remaps stand before the launch file that they hold for, parameters behind it,
    where the last value holds."""
    (text,) = configurations(programs()[name], Rig(rpm=300.0)).values()
    root = ET.fromstring(text)
    kinds = [child.tag for child in root]
    assert kinds == sorted(kinds, key=["remap", "include", "param"].index)
    (include,) = root.findall("include")
    assert re.fullmatch(r"\$\(find \w+\)/launch/\w+\.launch", include.get("file"))


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


def test_extrinsics_have_the_direction_that_each_program_wants():
    """A point that the lidar sees is at the same place for all of them.

    FAST-LIO2 has the lidar in the unit's frame, LIO-SAM and GLIM the unit in the lidar's, DLIO both in the
    body's, RKO-LIO the unit in its base, the lidar.
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


@pytest.mark.parametrize("model", ["vlp-17", "\ud800", 16])
def test_a_model_in_the_truth_that_is_not_known_is_bad_input(model):
    """A damaged `scenario.json` is named, with the models that it may have."""
    rig = {"units": [{"body_T_sensor": {"matrix": np.eye(4).tolist()}}]}
    with pytest.raises(InputError, match=r"scenario\.json: sensor\.model: found .*; expected hdl-32e or"):
        Rig.from_truth(rig, {"sensor": {"model": model, "rpm": 600}}, "velodyne")

"""Scores against cases by hand, evo's own alignment and brute force, and through the command line."""

import json
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vlp16emu import Emulator
from vlp16emu.cli import app
from vlp16emu.errors import InputError
from vlp16emu.extras.clouds.points import write_points
from vlp16emu.extras.options import ScoreInputs
from vlp16emu.extras.score.card import ScoreCard, limits_of, make_card
from vlp16emu.extras.score.files import Stem, read_cloud, read_stems
from vlp16emu.extras.score.measures import (
    box_scores,
    cloud_distances,
    density_per_m2,
    instance_scores,
    leaf_wood_scores,
    match_stems,
    stem_scores,
    uniformity,
)

POINTS = "x,y,z,semantic,part,leaf_wood,instance\n"


def stem(number, x_m, y_m=0.0, dbh_m=0.3):
    return Stem(number, x_m, y_m, 0.0, dbh_m, "")


@pytest.fixture
def truth(tmp_path):
    """Truth of a walk along an arc of 9 m that climbs, with two trees of 40 points each."""
    t_s = np.arange(0, 10, 0.1)
    turn = t_s / 10
    place_m = 9 * np.sin(turn), 9 * (1 - np.cos(turn)), t_s / 20
    rows = np.column_stack([1000 + t_s, *place_m, *np.zeros((2, 100)), np.sin(turn / 2), np.cos(turn / 2)])
    np.savetxt(tmp_path / "trajectory.tum", rows, fmt="%.9f")
    world = {"latitude_deg": 47.0, "longitude_deg": 8.0, "height_m": 500.0}
    unit = {"trajectory": "trajectory.tum", "address": "192.168.1.201", "data_port": 2368}
    unit["body_T_sensor"] = {"matrix": np.eye(4).tolist()}
    rig = {"units": [unit], "world": world, "antenna": {"above_sensor_m": 0.2}}
    (tmp_path / "rig.json").write_text(json.dumps(rig))
    with (tmp_path / "points.csv").open("w") as file:
        file.write(POINTS)
        for tree in (1, 2):
            for i in range(40):
                leaf = i >= 20
                place = f"{4 * tree + 0.01 * i},{3 + 0.01 * (i % 3)},{1.21 + 0.004 * i}"
                file.write(f"{place},2,{4 if leaf else 1},{1 + leaf},{tree}\n")
    (tmp_path / "trees.csv").write_text(
        "id,x_m,y_m,z_m,dbh_m,list_line\n1,4,3,0,0.30,17\n2,8,3,0,0.40,18\n3,80,3,0,0.40,19\n"
    )
    return tmp_path


def scored(capsys, *arguments):
    code = app.run(["score", *map(str, arguments), "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_the_truth_scores_perfectly(truth, capsys):
    """The truth as its own estimate has no error, and all of what there is to find; unseen trees are not
    missed, and a shrub is no tree."""
    points, trees = truth / "points.csv", truth / "trees.csv"
    with points.open("a") as file:
        file.writelines(f"{0.01 * i},6,0.5,3,4,2,9\n" for i in range(40))
    code, card = scored(
        capsys, truth, "--trajectory", truth / "trajectory.tum", "--map", points, "--points", points,
        "--truth-points", points, "--stems", trees, "--inventory", trees,
    )  # fmt: skip
    scores = card["scores"]
    assert code == 0
    assert scores["stamp_offset_s"] is None  # on an arc at a steady speed each offset is as good as any other
    errors = {name: value for name, value in scores.items() if name.endswith(("_m", "_deg"))}
    assert errors == pytest.approx(dict.fromkeys(errors, 0.0), abs=1e-6)
    shares = ("leaf_wood_miou", "pq", "sq", "rq", "box_map", "stem_recall", "completeness_5cm")
    assert [scores[name] for name in shares] == [1.0] * len(shares)
    assert scores["stem_precision"] == pytest.approx(2 / 3)  # the third is found where nothing was seen
    rows = [(row["true_id"], row["list_line"], row["hits"]) for row in card["trees"][:2]]
    assert rows == [("1", "17", 20), ("2", "18", 20)]


def test_alignment_is_that_of_evo(truth, capsys):
    """An estimate that is turned and shifted has no error once aligned; a noisy one has that of evo's own
    alignment."""
    from evo.core import metrics
    from evo.core.trajectory import PoseTrajectory3D

    rows = np.loadtxt(truth / "trajectory.tum")
    turned = rows.copy()
    turned[:, 1:3] = rows[:, 1:3] @ np.array([[0, 1], [-1, 0]]) + 5
    s, z, w = math.sqrt(0.5), rows[:, 6], rows[:, 7]
    turned[:, 6:] = np.column_stack([s * z + s * w, s * w - s * z])
    np.savetxt(truth / "turned.tum", turned, fmt="%.9f")
    for alignment, low, high in (("none", 5, 20), ("start", 0, 1e-6), ("yaw", 0, 1e-6), ("se3", 0, 1e-6)):
        _, card = scored(capsys, truth, "--trajectory", truth / "turned.tum", "--align", alignment)
        assert low <= card["scores"]["ate_m"] <= high
        assert card["scores"]["rpe_m"] < 1e-6
    turned[:, 1:4] += np.random.default_rng(1).normal(0, 0.1, (100, 3))
    np.savetxt(truth / "noisy.tum", turned, fmt="%.9f")
    _, card = scored(capsys, truth, "--trajectory", truth / "noisy.tum", "--align", "se3")
    pair = [PoseTrajectory3D(of[:, 1:4], of[:, [7, 4, 5, 6]], of[:, 0]) for of in (rows, turned)]
    pair[1].align(pair[0])
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data(pair)
    assert card["scores"]["ate_m"] == pytest.approx(ape.get_statistic(metrics.StatisticsType.rmse), abs=1e-6)


def test_distances_of_clouds_are_those_of_brute_force():
    """Chamfer distance and shares equal those of all pairs of points."""
    generator = np.random.default_rng(2)
    found, true = generator.random((60, 3)), generator.random((90, 3))
    apart = np.linalg.norm(found[:, None] - true, axis=-1)
    scores = cloud_distances(found, true, (0.1,))
    assert scores["chamfer_m"] == pytest.approx(apart.min(axis=1).mean() + apart.min(axis=0).mean())
    assert scores["precision_10cm"] == pytest.approx((apart.min(axis=1) <= 0.1).mean())
    assert scores["completeness_10cm"] == pytest.approx((apart.min(axis=0) <= 0.1).mean())


def test_density_and_uniformity_of_known_clouds():
    """A grid of 25 points per square metre has that density and is even; Poisson points have 1 / sqrt(N
    p); one heap is uneven."""
    axis = np.arange(-12, 12, 0.2)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    assert density_per_m2(grid, np.zeros(2), 10.0) == pytest.approx(25, rel=0.01)
    assert uniformity(grid, np.zeros(2), 10.0) < 0.05
    generator = np.random.default_rng(3)
    away, turn = 10 * np.sqrt(generator.random(20_000)), 2 * np.pi * generator.random(20_000)
    scattered = away[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    assert uniformity(scattered, np.zeros(2), 10.0) == pytest.approx(1 / math.sqrt(20_000 * 0.01), rel=0.15)
    assert uniformity(grid * 0.01, np.zeros(2), 10.0) > 5
    assert math.isnan(uniformity(grid + 100, np.zeros(2), 10.0))


def test_stems_are_paired_for_the_most_pairs():
    """The nearest found stem goes to another tree where that gives two pairs; precision, recall and errors
    follow."""
    true = [stem("1", 0.0), stem("2", 0.6), stem("3", 9.0)]
    found = [stem("a", 0.4, dbh_m=0.32), stem("b", 1.0, dbh_m=0.30), stem("c", 5.0)]
    pairs = match_stems(found, true, 0.5)
    assert sorted(pairs) == [(0, 0), (1, 1)]
    scores = stem_scores(found, true, pairs)
    assert (scores["stem_precision"], scores["stem_recall"]) == (2 / 3, 2 / 3)
    assert scores["stem_position_m"] == pytest.approx(0.4)
    assert (scores["dbh_bias_m"], scores["dbh_m"]) == pytest.approx((0.01, 0.02 / math.sqrt(2)))


def test_labels_by_hand():
    """Four points with one leaf taken for wood; unlabelled truth does not count."""
    scores = leaf_wood_scores(np.array([1, 1, 2, 0, 1]), np.array([1, 2, 2, 2, 0]))
    assert scores["leaf_wood_accuracy"] == 0.5
    assert (scores["wood_iou"], scores["leaf_iou"]) == (1 / 2, 1 / 3)


def test_panoptic_quality_by_hand():
    """One of two trees is found with 3 of 4 points, the other is split in halves, which are no match."""
    true = np.array([1, 1, 1, 1, 2, 2, 2, 2, 0])
    found = np.array([7, 7, 7, 0, 8, 8, 9, 9, 0])
    scores = instance_scores(found, true)
    assert scores["sq"] == 0.75
    assert scores["rq"] == pytest.approx(1 / (1 + 0.5 * 2 + 0.5 * 1))
    assert scores["pq"] == pytest.approx(0.75 * 0.4)


def test_average_precision_by_hand():
    """Boxes hit, miss, hit of two: precision 1 to recall 1/2, then 2/3; with IoU 0.6 the second counts up
    to 0.6."""
    true = np.array([[[0, 0, 0], [1, 1, 1]], [[5, 0, 0], [6, 1, 1]]], float)
    found = np.array([[[0, 0, 0], [1, 1, 1]], [[9, 0, 0], [10, 1, 1]], [[5, 0, 0], [6, 1, 0.625]]], float)
    scores = box_scores(found, np.array([30, 20, 10]), true)
    assert scores["box_ap_50"] == pytest.approx((1 + 2 / 3) / 2)
    assert scores["box_map"] == pytest.approx((3 * (1 + 2 / 3) / 2 + 7 * 0.5) / 10)


def test_a_missed_threshold_is_exit_code_1(truth, capsys):
    """Each threshold that is missed is named with its value; an unknown one is bad input."""
    arguments = [
        "score",
        str(truth),
        "--stems",
        str(truth / "trees.csv"),
        "--inventory",
        str(truth / "trees.csv"),
    ]
    assert app.run([*arguments, "--require", "stem_recall>=1", "--require", "dbh_m<0.01"]) == 0
    assert app.run([*arguments, "--require", "stem_recall>1"]) == 1
    assert "missed: stem_recall is 1, required > 1" in capsys.readouterr().out
    assert app.run([*arguments, "--require", "ate_m<1"]) == 2
    assert "found ate_m; expected stem_precision" in capsys.readouterr().err
    assert ScoreCard(None, {"ate_m": math.nan}).failed_limits(limits_of(["ate_m<0.3"]))


def test_own_numbers_of_trees_are_kept(truth, capsys):
    """A stem list's own number goes through as it is, for a pair and for a false stem."""
    (truth / "own.csv").write_text("Number,X,Y,dbh_cm\nA-07,4.1,3,31\nA-08,50,3,20\n")
    _, card = scored(capsys, truth, "--stems", truth / "own.csv", "--inventory", truth / "trees.csv")
    found = [(row["true_id"], row["found_number"]) for row in card["trees"]]
    assert found == [("1", "A-07"), ("2", ""), ("3", ""), ("", "A-08")]
    assert card["trees"][0]["dbh_error_m"] == pytest.approx(0.01)


def walk_of(path, duration_s=130.0, rate_hz=20):
    """Trajectory of a person who walks east at 1 m/s and sways at each pace, as rows of TUM."""
    t_s = np.arange(0, duration_s, 1 / rate_hz)
    sway = 2 * np.pi * 0.95 * t_s
    place_m = t_s, 0.03 * np.sin(sway), 0.02 * np.sin(2 * sway)
    rows = np.column_stack(
        [
            1000 + t_s,
            *place_m,
            np.sin(0.02 * np.sin(sway)),
            *np.zeros((2, len(t_s))),
            np.cos(0.02 * np.sin(sway)),
        ]
    )
    np.savetxt(path, rows, fmt="%.9f")
    return rows


def test_odometry_that_begins_anywhere_scores_as_if_it_began_at_the_truth(truth, capsys):
    """The first pose is laid on the truth by default: an estimate off by 1 % of the path has that drift
    over 10 and 100 m."""
    rows = walk_of(truth / "trajectory.tum")
    rows[:, 1] *= 1.01
    turn = Rotation.from_euler("zyx", [70, 10, 5], degrees=True)
    rows[:, 1:4] = turn.apply(rows[:, 1:4]) + [400.0, -7.0, 3.0]
    rows[:, 4:] = (turn * Rotation.from_quat(rows[:, 4:])).as_quat()
    np.savetxt(truth / "odometry.tum", rows[::2], fmt="%.9f")
    _, card = scored(capsys, truth, "--trajectory", truth / "odometry.tum")
    scores = card["scores"]
    # The sway makes the path longer than the way east, on which the drift is.
    assert scores["drift_10m_percent"] == pytest.approx(1.0, rel=0.05)
    assert scores["drift_100m_percent"] == pytest.approx(1.0, rel=0.05)
    assert scores["ate_max_m"] == pytest.approx(1.3, rel=0.01)
    assert scores["stamp_offset_s"] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("late_s", [0.1, -0.064])
def test_late_stamps_are_found(truth, capsys, late_s):
    """The offset of late stamps is reported; a motion without swing, or a path of 9 m, gives none."""
    rows = walk_of(truth / "trajectory.tum", 20.0)
    rows = rows[20:-20:2]
    rows[:, 0] += late_s
    np.savetxt(truth / "late.tum", rows, fmt="%.9f")
    _, card = scored(capsys, truth, "--trajectory", truth / "late.tum")
    assert card["scores"]["stamp_offset_s"] == pytest.approx(-late_s, abs=2e-3)
    assert card["scores"]["drift_100m_percent"] is None


BEGIN_S = 1_780_000_000.0


def winding_walk(path):
    """Trajectory of a walk as `walk_of` of 40 s from `BEGIN_S` on that winds ever more tightly."""
    rows = walk_of(path, 40.0)
    t_s = rows[:, 0] - 1000.0
    rows[:, 0] = BEGIN_S + t_s
    rows[:, 2] += np.sin(0.01 * t_s**2)
    np.savetxt(path, rows, fmt="%.9f")
    return rows


@pytest.mark.parametrize(
    ("epoch_s", "clock"),
    [(0.0, "UTC"), (-315_964_782.0, "GPS time"), (18.0, "GPS time since 1970"), (37.0, "TAI since 1970")],
)
def test_the_clock_of_an_estimate_is_found(truth, capsys, epoch_s, clock):
    """Stamps in GPS time, 18 s ahead since 2017 and from 1980 on (IERS Bulletin C), and in TAI, are found
    with the offset that they have on that clock."""
    rows = winding_walk(truth / "trajectory.tum")[::2]
    late_s = 0.064
    rows[:, 0] += epoch_s + late_s
    np.savetxt(truth / "found.tum", rows[5:-5], fmt="%.9f")
    _, card = scored(capsys, truth, "--trajectory", truth / "found.tum", "--time-offset", "auto")
    assert card["scores"]["time_offset_s"] == pytest.approx(epoch_s + late_s, abs=2e-3)
    assert card["scores"]["ate_m"] < 5e-3
    assert clock in card["notes"]["stamps"]


@pytest.mark.parametrize("begin_s", [0.0, 3.4])
def test_stamps_from_zero_are_found(truth, capsys, begin_s):
    """An estimate whose stamps begin at 0, and seconds after the truth, is moved to where its steps agree;
    with the same offset given, its scores are the same."""
    rows = winding_walk(truth / "trajectory.tum")[::2]
    rows = rows[rows[:, 0] >= BEGIN_S + begin_s]
    rows[:, 0] -= rows[0, 0]
    np.savetxt(truth / "found.tum", rows, fmt="%.9f")
    _, card = scored(capsys, truth, "--trajectory", truth / "found.tum", "--time-offset", "auto")
    offset_s = card["scores"]["time_offset_s"]
    assert offset_s == pytest.approx(-BEGIN_S - begin_s, abs=2e-3)
    _, given = scored(capsys, truth, "--trajectory", truth / "found.tum", "--time-offset", repr(offset_s))
    assert given["scores"]["ate_m"] == pytest.approx(card["scores"]["ate_m"], abs=1e-6)


def test_no_score_is_printed_as_nan(truth, capsys):
    """Scores of a path that is too short or too uniform say so; so does a threshold on one of them."""
    words = ["score", truth, "--trajectory", truth / "trajectory.tum", "--require", "drift_100m_percent<1"]
    assert app.run([*map(str, words)]) == 1
    printed = capsys.readouterr().out
    assert "nan" not in printed
    assert "drift_100m_percent is none: the path is shorter, required < 1" in printed


@pytest.mark.parametrize("row", ["1,2,3,32", "1,,3,0.3", "1,x,3,0.3"])
def test_a_wrong_stem_is_named(tmp_path, row):
    """A DBH in centimetres, a missing place and a word instead of a number are named with their line."""
    (tmp_path / "stems.csv").write_text(f"number,x,y,dbh\n{row}\n")
    with pytest.raises(InputError, match="line 2, column "):
        read_stems(tmp_path / "stems.csv")


def test_stems_are_compared_at_breast_height(tmp_path):
    """The place of a leaning tree in an inventory is its axis at breast height, where stem maps have it,
    and not its foot."""
    (tmp_path / "trees.csv").write_text(
        "id,x_m,y_m,z_m,x_breast_m,y_breast_m,dbh_m\n1,4,3,0,4.25,3.1,0.3\n2,8,3,0,,,0.4\n"
    )
    true, found = read_stems(tmp_path / "trees.csv"), [stem("a", 4.25, 3.1), stem("b", 8.0, 3.0, 0.4)]
    assert [(one.x_m, one.y_m) for one in true] == [(4.25, 3.1), (8.0, 3.0)]
    pairs = match_stems(found, true, 0.1)
    assert stem_scores(found, true, pairs)["stem_position_m"] == 0.0


def test_the_own_column_of_instances_goes_before_those_of_others(tmp_path):
    """A file with `instance` and `treeID`, as `points --labels for-instance` writes it, is scored by its
    instances."""
    np.savez(tmp_path / "a.npz", xyz=np.zeros((2, 3)), instance=[7, 8], treeID=[1, 0])
    np.savez(tmp_path / "b.npz", xyz=np.zeros((2, 3)), treeID=[1, 0])
    assert read_cloud(tmp_path / "a.npz")["instance"].tolist() == [7, 8]
    assert read_cloud(tmp_path / "b.npz")["instance"].tolist() == [1, 0]


def test_clouds_of_other_tools_are_read(tmp_path):
    """An ASCII PLY, and a LAZ with `treeID` and `leaf_wood` as laspy writes them, give their places and
    labels."""
    laspy = pytest.importorskip("laspy")
    xyz_m = np.random.default_rng(4).random((50, 3))
    header = laspy.LasHeader(point_format=6)
    header.scales = [1e-4] * 3
    header.add_extra_dims([laspy.ExtraBytesParams("treeID", "u4"), laspy.ExtraBytesParams("leaf_wood", "u1")])
    las = laspy.LasData(header)
    las.x, las.y, las.z = xyz_m.T
    las["treeID"], las["leaf_wood"] = np.arange(50), np.full(50, 2)
    las.write(tmp_path / "a.laz")
    cloud = read_cloud(tmp_path / "a.laz")
    np.testing.assert_allclose(cloud["xyz"], xyz_m, atol=6e-5)
    assert cloud["instance"].tolist() == list(range(50))
    axes = "".join(f"property double {axis}\n" for axis in "xyz")
    (tmp_path / "a.ply").write_text(
        f"ply\nformat ascii 1.0\nelement vertex 2\n{axes}property uchar leaf_wood\nend_header\n1 2 3 "
        "1\n4 5 6 2\n"
    )
    cloud = read_cloud(tmp_path / "a.ply")
    assert (cloud["xyz"].tolist(), cloud["leaf_wood"].tolist()) == ([[1, 2, 3], [4, 5, 6]], [1, 2])


def test_clouds_of_ours_are_read(tmp_path):
    """Each format that `points --truth` writes gives the places of the world to 0.1 mm, and the labels."""
    pytest.importorskip("laspy")
    emulator, clouds = Emulator("static_bench", {"sensor.max_range_m": 8.0}), []
    for suffix in ("npz", "ply", "csv", "pcd", "las", "laz"):
        write_points(emulator, tmp_path / f"a.{suffix}", duration_s=0.02, truth=True)
        clouds.append(read_cloud(tmp_path / f"a.{suffix}"))
        np.testing.assert_allclose(clouds[-1]["xyz"], clouds[0]["xyz"], atol=1e-4, err_msg=suffix)
        for name in ("semantic", "leaf_wood", "instance"):
            assert (clouds[-1][name] == clouds[0][name]).all(), suffix


@pytest.mark.parametrize("suffix", ["pcd", "laz", "npz", "ply", "csv"])
def test_a_damaged_cloud_is_one_line(tmp_path, suffix):
    """A file of words is named as what it should be, in one line."""
    pytest.importorskip("laspy")
    file = tmp_path / f"a.{suffix}"
    file.write_text("no points\n" * 300)
    with pytest.raises(InputError, match=r"a\.") as caught:
        read_cloud(file)
    assert "\n" not in str(caught.value)


def laz_file(path):
    """A LAZ file of laspy with a thousand points, and the places of its chunk table and laszip record."""
    laspy = pytest.importorskip("laspy")
    pytest.importorskip("lazrs")
    las = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
    las.xyz = np.random.default_rng(1).uniform(0, 10, (1000, 3))
    las.write(path, laz_backend=laspy.LazBackend.Lazrs)
    content = bytearray(path.read_bytes())
    points_at = int.from_bytes(content[96:100], "little")
    table_at = int.from_bytes(content[points_at : points_at + 8], "little")
    return content, table_at, content.find(b"laszip encoded") + 52


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        ("chunks", b"\xff\xff\xff\xff", "its reader ended by SIGABRT"),
        ("chunk size", b"\xf0\xff\xff\xff", "its reader ended by SIGABRT"),
        ("points", b"\0\0\0\0\0\1", "needs more memory than its reader may have"),
        ("items", b"\xff\xff", "cannot be read"),
        ("end", b"", "cannot be read"),
    ],
)
def test_a_laz_file_that_ends_its_library_is_one_line(tmp_path, place, value, message):
    """A damaged chunk table makes lazrs abort the process that reads it, with a panic of Rust over memory:
    here it is a line, and this process goes on."""
    path = tmp_path / "a.laz"
    content, table_at, laszip_at = laz_file(path)
    assert len(read_cloud(path)["xyz"]) == 1000
    at = {"chunks": table_at + 4, "chunk size": laszip_at + 12, "points": 247, "items": laszip_at + 32}
    if place == "end":
        content = content[: len(content) // 2]
    else:
        content[at[place] : at[place] + len(value)] = value
    path.write_bytes(content)
    with pytest.raises(InputError, match=rf"a\.laz: .*{message}.*; expected points as \.laz"):
        read_cloud(path)


def archive(path, damage):
    """An archive of numpy with points, of which some bytes are damaged."""
    np.savez(path, xyz=np.ones((50, 3)))
    content = bytearray(path.read_bytes())
    damage(content)
    path.write_bytes(content)


def test_a_damaged_archive_is_one_line(tmp_path, monkeypatch):
    """An archive that is cut, whose sum is wrong, or that unpacks to more than the bound, is one line."""
    path = tmp_path / "a.npz"

    def cut(content):
        del content[300:]

    def flip(content):
        content[400] ^= 0xFF

    for damage in (cut, flip):
        archive(path, damage)
        with pytest.raises(InputError, match=r"a\.npz: cannot be read: .*; expected points as \.npz"):
            read_cloud(path)
    np.savez_compressed(path, xyz=np.ones((50, 3)))
    monkeypatch.setattr("vlp16emu.extras.score.files._MOST_UNPACKED_BYTES", 1000)
    with pytest.raises(InputError, match="1328 bytes when unpacked"):
        read_cloud(path)


@pytest.mark.parametrize(
    ("xyz", "label", "message"),
    [
        (1.0, 1e300, r"a\.npz: instance: found 1e\+300; expected whole numbers"),
        (1.0, np.nan, r"a\.npz: instance: found nan; expected whole numbers"),
        (1.0, -np.inf, r"a\.npz: instance: found -inf"),
        (1e200, 1.0, r"a\.npz: found 1e\+200; expected positions of at most 1e\+08 m"),
        (np.inf, 1.0, r"a\.npz: found a NaN or infinity"),
    ],
)
def test_numbers_out_of_bounds_are_one_line(tmp_path, xyz, label, message):
    """Labels that are no whole numbers of int64 and positions off the earth are named, without a warning of
    numpy."""
    np.savez(tmp_path / "a.npz", xyz=np.full((3, 3), xyz), instance=np.array([1.0, label, 2.0]))
    with pytest.raises(InputError, match=message):
        read_cloud(tmp_path / "a.npz")


def test_arrays_that_are_no_table_are_one_line(tmp_path):
    """Labels for other points and places in a plane are refused."""
    for xyz, instance in ((np.zeros((3, 3)), [1, 2]), (np.zeros((3, 2)), [1, 2, 3])):
        np.savez(tmp_path / "a.npz", xyz=xyz, instance=instance)
        with pytest.raises(
            InputError, match=r"a\.npz: (instance: found \(2,\); expected \(3,\)|found positions of 2)"
        ):
            read_cloud(tmp_path / "a.npz")


def test_an_inventory_without_trees_has_none_to_find(tmp_path):
    """In a hall, whose inventory is a header, each found stem is false, also with true points."""
    trees, stems, true = (tmp_path / name for name in ("trees.csv", "stems.csv", "true.npz"))
    trees.write_text("id,x_m,y_m,dbh_m\n")
    stems.write_text("x,y,dbh\n1,2,0.3\n")
    np.savez(true, xyz=np.zeros((2, 3)), instance=[1, 2], part=[0, 0])
    card = make_card(ScoreInputs(tmp_path, stems=stems, inventory=trees, truth_points=true))
    assert [row.kind for row in card.trees] == ["false"]


def test_a_report_has_the_errors_along_the_path(truth, capsys):
    """An estimate that stays behind has its error at each pose over time and distance, thinned to a
    thousand poses, and the drift of each ten metres."""
    rows = np.loadtxt(truth / "trajectory.tum")
    fine = np.column_stack(
        [np.interp(np.linspace(1000, 1009, 3001), rows[:, 0], column) for column in rows.T]
    )
    fine[:, 6:] /= np.linalg.norm(fine[:, 6:], axis=1, keepdims=True)
    fine[:, 1] *= 0.99
    np.savetxt(truth / "slow.tum", fine, fmt="%.9f")
    _, card = scored(capsys, truth, "--trajectory", truth / "slow.tum", "--align", "none")
    path = card["path"]
    assert len(path["time_s"]) == len(path["error_m"]) == 1000
    assert (path["time_s"][0], path["time_s"][-1]) == (0.0, 9.0)
    assert path["distance_m"][-1] == pytest.approx(9 * 0.9, abs=0.1)
    assert path["error_m"] == pytest.approx(0.01 * np.abs(path["true_x_m"]), abs=2e-3)
    assert path["drift_percent"] == []  # the path is shorter than 10 m
    assert card["reference"] is None  # this truth has no scenario


def test_trees_have_their_distance_from_the_path(truth, capsys):
    """The range of a tree, found or missed, is its distance from the nearest point of the true path;
    without a path it is unknown."""
    _, card = scored(capsys, truth, "--stems", truth / "trees.csv", "--inventory", truth / "trees.csv")
    ranges = {row["true_id"]: row["range_m"] for row in card["trees"]}
    assert ranges["3"] == pytest.approx(
        math.hypot(80 - 9 * math.sin(0.99), 3 - 9 * (1 - math.cos(0.99))), abs=0.1
    )
    assert ranges["1"] == pytest.approx(9 - math.hypot(4, 9 - 3), abs=0.1)  # from the arc about (0, 9)
    (truth / "rig.json").unlink()
    _, card = scored(capsys, truth, "--stems", truth / "trees.csv", "--inventory", truth / "trees.csv")
    assert {row["range_m"] for row in card["trees"]} == {None}


def test_scores_are_written_as_a_page(truth, tmp_path):
    """`--out` writes a page and `--plot` a picture, a missed threshold is on the page, and the exit code
    is that of the threshold."""
    pytest.importorskip("matplotlib", reason="the extra plot is not installed")
    page, picture = tmp_path / "a.html", tmp_path / "a.svg"
    inputs = [
        "--trajectory",
        truth / "trajectory.tum",
        "--stems",
        truth / "trees.csv",
        "--inventory",
        truth / "trees.csv",
    ]
    words = [*inputs, "--require", "stem_f1>2", "--out", page, "--plot", picture]
    assert app.run(["score", *map(str, [truth, *words])]) == 1
    assert "missed: stem_f1 is 1, required &gt; 2" in page.read_text()
    assert "<td>trees.csv</td>" not in page.read_text()
    assert f"<td>{truth / 'trees.csv'}</td>" in page.read_text()
    assert 'id="found-path"' in picture.read_text()


def test_stems_without_a_reliable_dbh_are_scored_without_it(tmp_path):
    """DBH 0 and "Non Reliable", as 3DFin writes stems whose circle it rejects, are as an empty cell."""
    path = tmp_path / "stems.csv"
    path.write_text("TH,DBH,X,Y\n24.6,0.000,1,2\n22.4,Non Reliable,3,4\n20,,5,6\n21,0.25,7,8\n")
    dbh_m = [stem.dbh_m for stem in read_stems(path)]
    assert [math.isnan(value) for value in dbh_m] == [True, True, True, False]
    path.write_text("DBH,X,Y\n-0.1,1,2\n")
    with pytest.raises(
        InputError, match=r"line 2, column dbh: found -0\.1; expected a number from 0.001 to 15"
    ):
        read_stems(path)


@pytest.mark.parametrize("header", ["x y dbh", "x, y, dbh", "x,y,dbh", "x\ty\tdbh"])
@pytest.mark.parametrize("delimiter", [" ", ",", "\t", ";"])
def test_stems_of_numpy_are_read_with_any_header(tmp_path, header, delimiter):
    """`numpy.savetxt` writes its header behind `# `, with blanks or commas as its columns or not."""
    path = tmp_path / "stems.csv"
    np.savetxt(path, [[1.0, 2.0, 0.25], [3.0, 4.0, 0.5]], header=header, delimiter=delimiter)
    assert [(stem.x_m, stem.y_m, stem.dbh_m) for stem in read_stems(path)] == [(1, 2, 0.25), (3, 4, 0.5)]

"""Tests of the driver against the ground truth of each record: pip install 'vlp16emu[test]', then pytest."""

import numpy as np
import pytest
from driver import Driver


def read(vlp16, count):
    """Return the points of packets and the ground truth of their records, row by row."""
    driver, payloads = Driver(), vlp16.packets(count)
    points = [driver.points(payload) for payload in payloads]
    truth = np.concatenate([vlp16.truth(payload) for payload in payloads])
    return {name: np.concatenate([one[name] for one in points]) for name in points[0]}, truth


def test_points_lie_where_the_pulses_went(vlp16):
    """Each point is within 5 mm of its true position in the sensor frame.

    Half a block at 600 rpm is 2.6 cm at 15 m.
    """
    points, truth = read(vlp16, 76)
    there = points["range_m"] > 0
    xyz_m = np.stack([points["x_m"], points["y_m"], points["z_m"]], axis=1)
    assert np.abs(xyz_m - truth["sensor_m"])[there].max() < 0.005


def test_rings_count_from_below(vlp16):
    """Ring 0 is at -15 degrees, and each ring is 2 degrees above the previous one."""
    points, truth = read(vlp16, 10)
    there = points["range_m"] > 0
    elevation_deg = np.degrees(np.arcsin(truth["sensor_m"][there, 2] / truth["range_m"][there]))
    assert (
        np.abs(elevation_deg - (2 * points["ring"][there] - 15)).max() < 1
    )  # lasers sit up to 11 mm off the centre


@pytest.mark.vlp16("static_bench", {"sensor.return_mode": "dual", "beam.model": "adaptive"})
def test_the_last_return_comes_first(vlp16):
    """The last of two echoes of a pulse, the farther one, is marked."""
    points, truth = read(vlp16, 152)
    there = points["range_m"] > 0
    assert (truth["echo"] == 2).sum() > 10
    assert (points["is_last"] == (truth["echo"] == 1))[there].all()


@pytest.mark.vlp16("static_bench", {"start_utc": "2026-05-20T09:59:59.95Z", "gps.connected": True})
def test_time_goes_on_past_the_full_hour(vlp16):
    """Time differences of points equal the differences of their pulses within 2 us; time stamps have 1 us."""
    points, truth = read(vlp16, 76)
    since_s = (truth["t_ns"] - truth["t_ns"][0]) / 1e9
    assert np.abs(points["t_s"] - points["t_s"][0] - since_s).max() < 2e-6


@pytest.mark.vlp16("static_bench", {"events": [{"kind": "drop", "at_s": 0.05, "count": 5}]})
def test_lost_packets_are_counted(vlp16):
    """Five packets that the network drops are counted as lost."""
    driver = Driver()
    for payload in vlp16.packets(76):
        driver.points(payload)
    assert driver.lost == 5

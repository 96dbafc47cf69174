"""What a pulse's width, the detector and noise make of plates and walls, from the scene file to the packets."""

import numpy as np
import pytest
from scipy import stats

from vlp16emu.emulator import Emulator
from vlp16emu.packets import DATA_PAYLOAD, DISTANCE_LSB_M
from vlp16emu.scenario import load
from vlp16emu.types import PacketKind

PLATE_M, HALF_HOLE_M = 10.0, 0.005
LASER = 1
"""It looks up by 1 degree."""
HOLE_Z_M = 1.5 + (PLATE_M - 0.0419) * np.tan(np.radians(1.0))
HOLES_APART_M = 0.05
HOLES_M = np.arange(-20, 21) * HOLES_APART_M
EXACT = ("sensor.azimuth_noise_deg=0.0", "sensor.eccentricity_deg=0.0", "noise.preset=ideal")


def distances_m(scenario, stop_s):
    """Distances (blocks, 2, 16) as the packets have them."""
    packets = Emulator(scenario).packets(0.0, stop_s)
    payload = b"".join(packet.payload for packet in packets if packet.kind is PacketKind.DATA)
    records = np.frombuffer(payload, DATA_PAYLOAD)["blocks"]["records"]
    return records["distance_lsb"].reshape(-1, 2, 16) * DISTANCE_LSB_M


@pytest.mark.parametrize(
    ("gap_m", "behind_m"),
    [(0.3, [(0.1, 0.2)]), (0.7, [(0.0, 0.7)]), (1.5, [(0.0, 0.0), (1.5, 1.5)]), (5.0, [(0.0, 0.0), (5.0, 5.0)])],
)
def test_a_step_edge_is_one_return_or_two(gap_m, behind_m):
    """With the beam half on each of two plates, packets show one return between them below 1.4 m, and both plates above."""
    middle_m = PLATE_M + 0.05
    near = f"{{ name = 'near', centre_m = [{middle_m}, -2.5, 3.0], size_m = [0.1, 5.0, 6.0] }}"
    far = f"{{ name = 'far', centre_m = [{middle_m + gap_m}, 0.0, 3.0], size_m = [0.1, 10.0, 6.0] }}"
    # The rotor turns by 3600 degrees per second until laser 1 fires in sequence 10, so that it stands at 0.
    own = [f"sensor.start_azimuth_deg={360 - 3600 * (10 * 55.296e-6 + 2.304e-6)}", "world.length_m=40.0"]
    scenario = load(
        "static_bench",
        [*EXACT, "sensor.return_mode=dual", *own, f"world.boxes=[{near}, {far}]", "world.poles=[]", "beam={}"],
    )
    last_m, other_m = distances_m(scenario, 0.001)[10:12, 0, LASER]
    found_m = np.unique([other_m, last_m]) * np.cos(np.radians(1.0)) - PLATE_M
    assert len(found_m) == len(behind_m)
    for at_m, (low_m, high_m) in zip(found_m, behind_m, strict=True):
        assert low_m - 0.02 < at_m < high_m + 0.02


@pytest.fixture(scope="module")
def holes(tmp_path_factory):
    """Settings that put a plate with holes of one centimetre before the sensor."""
    across = [-2.0, *(edge for hole in HOLES_M for edge in (hole - HALF_HOLE_M, hole + HALF_HOLE_M)), 2.0]
    low, high = HOLE_Z_M - HALF_HOLE_M, HOLE_Z_M + HALF_HOLE_M
    strips = [(-2.0, 2.0, 0.5, low), (-2.0, 2.0, high, 2.5)]
    strips += [(a, b, low, high) for a, b in zip(across[::2], across[1::2], strict=True)]
    lines = ["o plate"]
    for y0, y1, z0, z1 in strips:
        lines += [f"v {PLATE_M} {y:.6f} {z:.6f}" for y, z in ((y0, z0), (y1, z0), (y1, z1), (y0, z1))]
    lines += [f"f {4 * i + 1} {4 * i + 2} {4 * i + 3} {4 * i + 4}" for i in range(len(strips))]
    file = tmp_path_factory.mktemp("plate") / "plate.obj"
    file.write_text("\n".join(lines) + "\n")
    place = "places = [{ x_m = 0.0, y_m = 0.0, z_m = 0.0 }]"
    mesh = f"world.meshes=[{{ file = '{file}', unit = 'm', up = 'z', {place} }}]"
    return [*EXACT, mesh, "world.poles=[]", "sensor.rpm=300"]


def through_holes(settings, stop_s):
    """How far off the nearest hole the middles of pulses at the plate are, (n, 2) m, and which pulses see the wall."""
    off_m, seen = [], []
    for returns in Emulator(load("static_bench", settings)).returns(0.0, stop_s):
        origin_m, direction = returns.firings.origin_m[:, LASER], returns.firings.direction[:, LASER]
        way_m = (PLATE_M - origin_m[:, 0]) / direction[:, 0]
        y_m, z_m = (origin_m + way_m[:, None] * direction)[:, 1:].T
        near = (way_m > 0) & (np.abs(y_m) < 1.0)
        y_m, z_m = y_m[near], z_m[near]
        nearest_m = HOLES_M[np.abs(y_m[:, None] - HOLES_M).argmin(axis=1)]
        off_m.append(np.column_stack([y_m - nearest_m, z_m - HOLE_Z_M]))
        seen.append(returns.distance_m[near, LASER, 0] > PLATE_M + 2)
    return np.concatenate(off_m), np.concatenate(seen)


def test_pulses_see_through_holes_as_often_as_the_profile_says(holes):
    """The wall is seen behind the holes with the probability of the profile's integral, at each distance off them (chi-square)."""
    off_m, seen = through_holes([*holes, "beam={model='angle'}"], 6.0)
    sigma_m = np.array([0.0127 + 0.003 * PLATE_M, 0.0095 + 0.0015 * PLATE_M]) / 4
    # The holes beside the nearest one let a third of the light through that comes in between.
    holes_m = off_m[:, None] - [[-HOLES_APART_M, 0.0], [0.0, 0.0], [HOLES_APART_M, 0.0]]
    edges = stats.norm.cdf((HALF_HOLE_M - holes_m) / sigma_m) - stats.norm.cdf((-HALF_HOLE_M - holes_m) / sigma_m)
    p = edges.prod(axis=2).sum(axis=1)
    rings = np.digitize(np.abs(off_m[:, 0]), [0.005, 0.01, 0.015, 0.02])
    expected, found, variance = (np.bincount(rings, weights=w) for w in (p, seen, p * (1 - p)))
    assert expected.sum() > 300
    assert ((found - expected) ** 2 / variance).sum() < stats.chi2.isf(1e-3, 5)


def test_without_width_holes_are_sharp(holes):
    """With neither spot nor divergence a pulse sees the wall exactly where its middle passes a hole."""
    sharp = "beam={model='angle', spot_mm=[0.0, 0.0], divergence_mrad=[0.0, 0.0]}"
    off_m, seen = through_holes([*holes, sharp], 1.0)
    beside = np.abs(off_m).max(axis=1) - HALF_HOLE_M
    assert seen[beside < -1e-5].all()
    assert not seen[beside > 1e-5].any()
    assert seen.sum() > 50


@pytest.fixture(scope="module")
def errors():
    """Errors of ranges on the walls (turns, pulses, 16) before packing, in packets, and the sigma that is due."""
    own = ["world.poles=[]", "world.boxes=[]", "world.spheres=[]"]
    unit = [*own, "noise={preset='typical', elevation_error_deg=0.0, azimuth_error_deg=0.0}"]
    own.append("noise.preset=ideal")
    stop_s = 1.0
    true, real = (list(Emulator(load("static_bench", settings)).returns(0.0, stop_s)) for settings in (own, unit))
    true_m, real_m = (np.concatenate([r.distance_m[..., 0] for r in run]).astype(float) for run in (true, real))
    shown = np.concatenate([r.reflectivity[..., 0] for r in true]) / 100
    sent_m = distances_m(load("static_bench", unit), stop_s).reshape(-1, 16)
    # The least error of a pulse of 6 ns of that signal over noise, 6 for 10 % at 40 m.
    weak_m = 0.299792458 / 2 * 6.0 / 2.35482 * 0.1 / 40**2 / 6 * true_m**2 / shown
    sigma_m = np.hypot(0.0065 * (0.2 / shown) ** 0.25, weak_m)
    n = len(sent_m)
    return real_m[:n] - true_m[:n], sent_m - true_m[:n], sigma_m[:n]


def test_range_noise_is_gaussian_with_the_sigma_that_is_set(errors):
    """Errors of a typical unit, less their laser's bias, are normal with the sigma of the setting (Kolmogorov-Smirnov)."""
    error_m, sent_m, sigma_m = errors
    white = (error_m - error_m.mean(axis=0)) / sigma_m
    assert white.std() == pytest.approx(1.0, abs=0.01)
    assert min(stats.kstest(white[:, laser], "norm").pvalue for laser in range(16)) > 0.01 / 16
    of_grid_m = 0.002 / np.sqrt(12)
    sent = (sent_m - sent_m.mean(axis=0)) / np.hypot(sigma_m, of_grid_m)
    assert sent.std() == pytest.approx(1.0, abs=0.01)


def test_bias_is_constant_per_laser_over_a_run(errors):
    """In packets each laser has an offset of its own, the same in all tenths of the run within its error."""
    _, sent_m, sigma_m = errors
    tenths_m = np.array([part.mean(axis=0) for part in np.array_split(sent_m, 10)])
    standard_error_m = sigma_m.mean() / np.sqrt(len(sent_m) / 10)
    bias_m = tenths_m.mean(axis=0)
    assert np.abs(tenths_m - bias_m).max() < 4.5 * standard_error_m
    assert 0.004 < bias_m.std() < 0.02
    assert len(np.unique(bias_m.round(4))) == 16

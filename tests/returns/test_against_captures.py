"""Range noise of a real unit against the `unit` preset, by one and the same estimator."""

from pathlib import Path

import dpkt
import numpy as np
import pytest

from vlp16emu.packets import DATA_PAYLOAD, DISTANCE_LSB_M
from vlp16emu.returns.detect import detect
from vlp16emu.returns.settings import Noise
from vlp16emu.types import NO_SURFACE, Hits

CAPTURE = Path(__file__).resolve().parents[2].parent / "shared" / "captures" / "mrpt_vlp16_gps.pcap"
BIN_CDEG = 40
SMOOTH_M = 0.03


def first_sequences(payloads):
    """Azimuth (n,), distance and reflectivity (n, 16) of the first firing sequence of each block."""
    blocks = np.frombuffer(payloads, DATA_PAYLOAD)["blocks"].reshape(-1)
    records = blocks["records"].reshape(len(blocks), -1)[:, :16]
    return (blocks["azimuth_cdeg"].astype(np.int64), records["distance_lsb"] * DISTANCE_LSB_M, records["reflectivity"])


def by_revolution(azimuth_cdeg, values):
    """Values (revolutions, bins, 16) of whole revolutions, those next to the middle of each azimuth bin."""
    revolution = np.cumsum(np.diff(azimuth_cdeg, prepend=azimuth_cdeg[0]) < -18_000)
    middles = np.arange(0, 36_000, BIN_CDEG) + BIN_CDEG // 2
    rows = []
    for turn in range(1, revolution[-1]):
        inside = np.flatnonzero(revolution == turn)
        nearest = np.abs(azimuth_cdeg[inside] - middles[:, None]).argmin(axis=1)
        rows.append(values[inside[nearest]])
    return np.stack(rows)


def white_noise_m(distance_m):
    """Median over laser and azimuth of the standard deviation over revolutions, where the scene is smooth.

    Of three values the median of the sample deviation is 0.833 sigma.
    """
    near = np.stack([np.roll(distance_m, shift, axis=1) for shift in (-1, 0, 1)])
    smooth = (near > 0).all(axis=(0, 1)) & (np.ptp(near, axis=(0, 1)) < SMOOTH_M)
    assert smooth.sum() > 1000
    return np.median(distance_m[:, smooth].std(axis=0, ddof=1)) / 0.833


@pytest.mark.skipif(not CAPTURE.exists(), reason="no captures of real sensors at ../shared/captures")
def test_white_noise_of_a_real_unit_is_that_of_the_unit_preset(detector, firings, table):
    """Over three revolutions of a static scene, a real unit scatters as the emulated one at the same targets, to 15 %."""
    with CAPTURE.open("rb") as file:
        payloads = b"".join(frame[42:] for _, frame in dpkt.pcap.Reader(file) if len(frame) == 1248)
    azimuth_cdeg, distance_m, reflectivity = first_sequences(payloads)
    real = by_revolution(azimuth_cdeg, distance_m)
    assert len(real) == 3
    mean_m = np.where((real > 0).all(axis=0), real.mean(axis=0), np.inf).astype(np.float32)
    hit = np.isfinite(mean_m)
    percent = by_revolution(azimuth_cdeg, reflectivity).mean(axis=0).clip(1, 100).astype(np.float32)
    hits = Hits.one_ray_each(
        mean_m, np.where(hit, 0, NO_SURFACE).astype(np.uint32), np.where(hit, percent / 100, 0).astype(np.float32)
    )
    k = len(mean_m)
    unit = detector(Noise(preset="unit", unit_spread=0.0))
    emulated = np.stack(
        [
            detect(firings(k, turn * (k + 1)), hits, table(1.0), unit, truth=False).distance_m[..., 0].astype(float)
            for turn in range(3)
        ]
    )
    on_grid = np.rint(emulated / DISTANCE_LSB_M) * DISTANCE_LSB_M
    smooth_m = white_noise_m(on_grid)
    assert 0.0047 < white_noise_m(real) < 0.0097
    assert white_noise_m(real) == pytest.approx(smooth_m, rel=0.15)

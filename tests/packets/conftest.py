"""What the tests of this room share: returns made by hand, and real captures where they are at hand."""

from pathlib import Path

import dpkt
import numpy as np
import pytest

from vlp16emu.types import Firings, Returns

CAPTURES = Path(__file__).resolve().parents[3] / "shared" / "captures"


@pytest.fixture
def make_returns():
    """Build k firing sequences from what the packer looks at; the rest is zero."""

    def make(sequences, *, clock_ns=0, t_ns=0, reading_deg=None, distance_m=None, reflectivity=None, lasers=16):
        steps_ns = np.arange(sequences) * 55_296
        firings = Firings(
            index=0,
            t_ns=t_ns + steps_ns[:, None] + np.arange(lasers) * 2_304,
            clock_ns=(clock_ns + steps_ns) % (3_600 * 10**9),
            azimuth_deg=np.zeros((sequences, lasers)),
            reading_deg=np.zeros(sequences) if reading_deg is None else reading_deg,
            origin_m=np.zeros((sequences, lasers, 3)),
            direction=np.zeros((sequences, lasers, 3)),
            beam_axis=None,
        )
        none = np.zeros((sequences, lasers, 3))
        return Returns(
            firings,
            none.astype(np.float32) if distance_m is None else distance_m,
            none.astype(np.uint8) if reflectivity is None else reflectivity,
        )

    return make


@pytest.fixture
def random_returns(make_returns):
    """Build k firing sequences with one, two, three or no returns per pulse, and a rotor that turns."""

    def make(sequences, seed):
        random = np.random.default_rng(seed)
        shape = (sequences, 16)
        distance_m = random.uniform(0.0, 140.0, (*shape, 3)).astype(np.float32)
        kind = random.integers(0, 4, shape)
        # The strongest is the last in kinds 1 and 3; there is no second strongest in kind 1; kind 0 is a miss.
        distance_m[..., 1] = np.where((kind == 1) | (kind == 3), distance_m[..., 0], distance_m[..., 1])
        distance_m[..., 2][kind == 1] = 0
        distance_m[kind == 0] = 0
        reflectivity = random.integers(0, 256, (*shape, 3), dtype=np.uint8)
        same = distance_m[..., 0] == distance_m[..., 1]
        reflectivity[..., 1][same] = reflectivity[..., 0][same]
        reflectivity[..., 2][kind <= 1] = 0
        turned_deg = np.arange(sequences) * 0.1990656 + random.normal(0, 0.005, sequences)
        reading_deg = (random.uniform(0, 360) + turned_deg) % 360
        return make_returns(
            sequences,
            clock_ns=int(random.integers(0, 3_600 * 10**9)),
            reading_deg=reading_deg,
            distance_m=distance_m,
            reflectivity=reflectivity,
        )

    return make


def _capture(name):
    if not (CAPTURES / name).exists():
        pytest.skip(f"no real captures: {CAPTURES.name}/{name} is not at hand")
    return CAPTURES / name


def _payloads(length):
    with _capture("mrpt_vlp16_gps.pcap").open("rb") as file:
        return [(stamp, frame[42:]) for stamp, frame in dpkt.pcap.Reader(file) if len(frame) == 42 + length]


@pytest.fixture
def real_single():
    """293 data packets of a real unit: strongest return, 600 rpm, locked to GPS."""
    return np.frombuffer(b"".join(payload for _, payload in _payloads(1206)), np.uint8).reshape(-1, 1206)


@pytest.fixture
def real_dual():
    """603 data packets of another real unit: dual return, 600 rpm, no GPS."""
    return np.fromfile(_capture("nebula_vlp16_dual.bin"), np.uint8).reshape(-1, 1206)


@pytest.fixture
def real_position():
    """57 position packets of the first unit, each with its arrival in seconds."""
    return _payloads(512)

"""Peaks of the waveform against a slow and obvious twin, and the pairs of dual return that come of them."""

import itertools

import numpy as np
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from returns.kit import detector, firings, table

from vlp16emu.packets import DATA_PAYLOAD, DISTANCE_LSB_M
from vlp16emu.packets.data import data_payloads
from vlp16emu.returns.detect import detect
from vlp16emu.returns.echoes import AMPLITUDE, COLUMNS, RANGE, SubRays, find_peaks, gather
from vlp16emu.types import NO_SURFACE, Hits, ReturnMode, SensorModel

SIGMA_M = 0.299792458 / 2 * 6.0 / 2.3548200450309493
STEP_M = 0.001
RESOLUTION_M = 1.4


def waveform(x_m, range_m, amplitude):
    """Sum of the pulses at (n,) ranges."""
    away = (x_m[:, None] - range_m) / SIGMA_M
    return np.exp(-0.5 * away**2) @ amplitude


def peaks_on_a_grid(range_m, amplitude):
    """Range and height of all peaks, and by what share each stands out of the higher of its two valleys."""
    x_m = np.arange(range_m.min() - 0.01, range_m.max() + 0.01, STEP_M)
    height = waveform(x_m, range_m, amplitude)
    top = np.flatnonzero((height[1:-1] > height[:-2]) & (height[1:-1] >= height[2:])) + 1
    edges = [0, *(a + height[a:b].argmin() for a, b in itertools.pairwise(top)), len(x_m) - 1]
    dip = [
        height[t] - max(height[a] if a else 0, height[b] if b < len(x_m) - 1 else 0)
        for t, a, b in zip(top, edges[:-1], edges[1:], strict=True)
    ]
    return x_m[top], height[top], np.array(dip) / height[top]


def found(range_m, amplitude):
    """Peaks by the kernel."""
    nodes = np.empty((COLUMNS, len(range_m)))
    nodes[RANGE], nodes[AMPLITUDE] = range_m, amplitude
    peaks = np.empty((COLUMNS, 3 * len(range_m)))
    peaks = peaks[:, : find_peaks(nodes, len(range_m), SIGMA_M, peaks)]
    return peaks[RANGE], peaks[AMPLITUDE]


def obvious_returns(range_m, reflectance):
    """Strongest, last and second strongest by the twin, with the heights of all; None where it is a close
    call."""
    amplitude = reflectance / len(range_m) / range_m**2
    x_m, height, dip = peaks_on_a_grid(range_m, amplitude)
    if (dip < 0.02).any():
        return None
    order = np.argsort(-height)
    if (height[order][1:] > 0.98 * height[order][:-1]).any():
        return None
    kept = []
    for peak in order:
        gaps_m = np.abs([x_m[peak] - x_m[k] for k in kept])
        if (np.abs(gaps_m - RESOLUTION_M) < 0.01).any():
            return None
        if (gaps_m > RESOLUTION_M).all():
            kept.append(peak)
    second_m = x_m[kept[1]] if len(kept) > 1 else 0.0
    return x_m[kept[0]], x_m[kept].max(), second_m


lights = st.lists(st.tuples(st.floats(0, 6), st.floats(0.02, 1.0)), min_size=1, max_size=12)


@settings(max_examples=80, deadline=None)
@given(lights)
@example([(0.0, 1.0), (0.0, 1.0), (6e-16, 1.0)])
def test_peaks_are_those_of_the_waveform(light):
    """The kernel finds every peak that a 1 mm grid shows, but for shoulders of 5 %, at its place and
    height, and no other."""
    range_m, amplitude = 5.0 + np.array(light).T[0], np.array(light).T[1]
    want_m, want, dip = peaks_on_a_grid(range_m, amplitude)
    assume(not (dip < 0.05).any())
    got_m, got = found(range_m, amplitude)
    assert len(got_m) == len(want_m)
    np.testing.assert_allclose(np.sort(got_m), want_m, atol=0.002)
    np.testing.assert_allclose(got[np.argsort(got_m)], want, rtol=1e-3)


def test_peaks_come_in_order_of_range():
    """Peaks are listed from near to far, whatever the order of the nodes."""
    rng = np.random.default_rng(5)
    for _ in range(50):
        got_m, _ = found(rng.uniform(1, 30, 20), rng.uniform(0.1, 1, 20))
        assert (np.diff(got_m) > 0).all()


def nodes_by_definition(range_m, light, reach_m):
    """Ranges and energies of nodes: each takes the sub-rays near the first one left, in their order."""
    left = np.flatnonzero(np.isfinite(range_m))
    found = []
    while len(left):
        first_m = np.float64(range_m[left[0]])
        energy = moment = 0.0
        near = np.abs(np.float64(range_m[left]) - first_m) <= reach_m
        for ray in left[near]:
            energy += light[ray]
            moment += light[ray] * (np.float64(range_m[ray]) - first_m)
        found.append((first_m + moment / energy, energy))
        left = left[~near]
    return found


def test_sub_rays_are_summed_into_nodes_in_their_order():
    """Nodes of one to twelve sub-rays, where eight are summed side by side, are those of the definition to
    the last bit, with sub-rays that meet nothing among them."""
    rng = np.random.default_rng(2)
    constants = detector().constants
    reflectance = rng.uniform(0.0, 1.0, 5).astype(np.float32)
    for _ in range(2000):
        n = int(rng.choice([1, 5, 8, 8, 8, 8, 9, 12]))
        range_m = rng.choice(rng.uniform(1.0, 60.0, 3), n) + rng.uniform(0.0, 0.2, n)
        range_m = np.where(rng.random(n) < 0.2, np.inf, range_m).astype(np.float32)
        met = np.where(np.isinf(range_m), NO_SURFACE, rng.integers(0, 5, n)).astype(np.uint32)
        cosine = rng.uniform(0.0, 1.0, n).astype(np.float32)
        nodes = np.empty((COLUMNS, n + 1))
        found = gather(
            constants, SubRays(np.array([[n]], np.uint16), range_m, met, cosine, reflectance), 0, n, nodes
        )
        light = np.float64(reflectance[np.minimum(met, 4)]) * np.float64(cosine) + 1e-9
        expected = nodes_by_definition(range_m, light, 0.075)
        at_m = np.array([at for at, _ in expected])
        amplitude = np.array([max(energy / n, 1e-9) / (at * at) for at, energy in expected])
        assert nodes[RANGE, :found].tobytes() == at_m.tobytes()
        assert nodes[AMPLITUDE, :found].tobytes() == amplitude.tobytes()


def test_two_equal_pulses_part_at_two_sigmas():
    """Two equal Gaussians have one peak, in the middle, up to two sigmas between them, and two peaks from
    there on."""
    for gap_sigmas in (0.5, 1.0, 1.9, 1.99):
        got_m, _ = found(np.array([9.0, 9.0 + gap_sigmas * SIGMA_M]), np.ones(2))
        np.testing.assert_allclose(got_m, [9.0 + gap_sigmas / 2 * SIGMA_M], atol=2e-3)
    for gap_sigmas in (2.05, 2.5, 4.0, 6.0):
        assert len(found(np.array([9.0, 9.0 + gap_sigmas * SIGMA_M]), np.ones(2))[0]) == 2


sub_rays = st.lists(st.tuples(st.floats(2, 8), st.floats(0.05, 1.0)), min_size=1, max_size=8)


@settings(max_examples=30, deadline=None)
@given(st.lists(sub_rays, min_size=1, max_size=16))
def test_returns_are_those_of_the_twin(batch):
    """Strongest, last and second strongest stand where the waveform on a grid has them: to 4 mm or, on
    flat tops, 0.1 %."""
    want = [obvious_returns(*np.array(pulse).T) for pulse in batch]
    batch = (batch * 16)[:16]
    out = detect_pulses(detector(), 1, batch)
    for pulse, expected in enumerate(want):
        if expected is not None:
            got = out.distance_m[0, pulse]
            range_m, reflectance = np.array(batch[pulse]).T
            height = [waveform(np.float64(at), range_m, reflectance / range_m**2) for at in (got, expected)]
            close = (np.abs(got - expected) < 0.004) | (np.abs(height[0] / height[1] - 1) < 1e-3)
            assert close.all(), (got, expected)


def detect_pulses(unit, sequences, batch):
    """Detect pulses of (range, reflectance) each; a range below 0 stands for a miss."""
    rays = np.concatenate(batch)
    range_m = np.where(rays[:, 0] < 0, np.inf, rays[:, 0]).astype(np.float32)
    n = len(range_m)
    count = np.array([len(pulse) for pulse in batch], np.uint16).reshape(-1, 16)
    surface = np.where(np.isinf(range_m), 0xFFFFFFFF, np.arange(n)).astype(np.uint32)
    hits = Hits(count, range_m, surface, np.isfinite(range_m).astype(np.float32))
    return detect(firings(sequences), hits, table(*rays[:, 1]), unit, truth=True)


anything = st.lists(
    st.tuples(st.one_of(st.just(-1.0), st.floats(0.1, 0.7), st.floats(0.5, 104)), st.floats(0.0, 2.0)),
    min_size=1,
    max_size=9,
)


@settings(max_examples=20, deadline=None)
@given(st.lists(anything, min_size=24, max_size=24), st.booleans(), st.sampled_from([None, 60.0]))
def test_every_dual_pair_is_lawful(batch, noisy, visibility_m):
    """Whatever is hit: even blocks hold the last return, odd ones no farther one, 1 m apart if two, and
    one alone twice."""
    noise = {
        "range_noise_m": 0.0065,
        "range_bias_m": 0.01,
        "reflectivity_noise": 1.5,
        "weak_echoes_lost": True,
    }
    unit = detector(noise if noisy else None, visibility_m=visibility_m)
    returns = detect_pulses(unit, 12, batch * 8)
    payload = data_payloads(returns, ReturnMode.DUAL, SensorModel.VLP_16).tobytes()
    records = np.frombuffer(payload, DATA_PAYLOAD)["blocks"]["records"][0]
    last, other = (records[half::2]["distance_lsb"].astype(int) for half in (0, 1))
    both = (last > 0) & (other > 0)
    assert (last[both] >= other[both]).all()
    apart_m = (last - other)[both & (last != other)] * DISTANCE_LSB_M
    assert (apart_m >= RESOLUTION_M - (0.5 if noisy else 0.002)).all()
    same = last == other
    even, odd = (records[half::2]["reflectivity"] for half in (0, 1))
    assert (even[same & (last > 0)] == odd[same & (last > 0)]).all()
    assert max(last.max(), other.max()) * DISTANCE_LSB_M <= 100.001

"""Noise, bias and detection by their distributions."""

import numpy as np
import pytest
from returns.kit import detector, firings, pulses, table
from scipy import stats

from vlp16emu.returns.detect import detect
from vlp16emu.returns.noise import BIAS_LIMIT_M, no_return_reflectivity, range_bias_m
from vlp16emu.returns.settings import Noise
from vlp16emu.types import NO_SURFACE

K = 4000


def seen(noise, range_m=10.0, reflectance=0.2, *, k=K, index=0, t_ns=0, **own):
    """Returns of K sequences at one target."""
    hits = pulses(k, [range_m], [NO_SURFACE if np.isinf(range_m) else 0])
    return detect(firings(k, index, t_ns), hits, table(reflectance), detector(noise, **own), truth=False)


def test_white_noise_is_gaussian_with_the_sigma_that_is_set():
    """Range errors at 20 % and short range are normal with the given sigma (Kolmogorov-Smirnov)."""
    error_m = seen({"range_noise_m": 0.0065}).distance_m[..., 0].ravel().astype(np.float64) - 10.0
    assert stats.kstest(error_m / 0.0065, "norm").pvalue > 0.01
    assert error_m.std() == pytest.approx(0.0065, rel=0.02)


def test_noise_is_independent_between_pulses_and_lasers():
    """Errors of neighbours in time and of neighbouring lasers are uncorrelated."""
    error_m = seen({"range_noise_m": 0.0065}).distance_m[..., 0].astype(np.float64) - 10.0
    limit = 4 / np.sqrt(error_m.size)
    assert abs(np.corrcoef(error_m[1:].ravel(), error_m[:-1].ravel())[0, 1]) < limit
    assert abs(np.corrcoef(error_m[:, 1:].ravel(), error_m[:, :-1].ravel())[0, 1]) < limit


@pytest.mark.parametrize(
    ("reflectance", "sigma_m"), [(0.025, 0.0045), (0.12, 0.0036), (0.27, 0.0034), (0.6, 0.0030)]
)
def test_noise_grows_on_dark_targets(reflectance, sigma_m):
    """A unit with 3.5 mm at a reflectivity of 20 shows what the real one does that is called C, on even
    surfaces without its beat and counts, at codes of 10 to 90; and a third more at 2."""
    error_m = seen({"range_noise_m": 0.0035}, 4.0, reflectance).distance_m[..., 0] - np.float32(4)
    assert error_m.std() == pytest.approx(sigma_m, rel=0.05)


def test_noise_grows_where_light_is_short():
    """At the detection threshold the noise is the pulse's width over the signal-to-noise ratio, 64 mm at
    6."""
    out = seen({"range_noise_m": 0.0065, "weak_echoes_lost": True}, 40.0, 0.1).distance_m[..., 0]
    sigma_m = 0.299792458 / 2 * 6.0 / 2.35482 / 6
    assert out[out > 0].std() == pytest.approx(np.hypot(sigma_m, 0.0065 * 2**0.25), rel=0.02)


def test_bias_is_constant_per_laser_and_gaussian_over_units():
    """Each laser keeps its error, another seed is another unit, none exceeds the data sheet; over many
    lasers they are normal but for the cut."""
    early, late = (
        seen({"range_bias_m": 0.01}, k=8, index=n).distance_m[..., 0] - np.float32(10) for n in (0, 10**6)
    )
    assert (early == early[0]).all()
    assert (late == early).all()
    assert len(np.unique(early[0])) == 16
    other = seen({"range_bias_m": 0.01}, k=1, seed=2).distance_m[0, :, 0] - np.float32(10)
    assert (other != early[0]).all()
    assert np.abs(range_bias_m(3, 10_000, 0.02)).max() == BIAS_LIMIT_M
    assert stats.kstest(range_bias_m(7, 5000, 0.008) / 0.008, "norm").pvalue > 0.01


def test_warm_up_fades_exponentially():
    """Ranges are too long by the drift at power-up, by 1 / e of it one time constant later, and right in
    the end."""
    for since_s, share in ((0, 1.0), (900, np.exp(-1)), (60_000, 0.0)):
        out = seen({"warm_up_m": 0.05}, k=1, t_ns=since_s * 10**9)
        np.testing.assert_allclose(out.distance_m[..., 0] - 10, 0.05 * share, atol=2e-6)


def test_reflectivity_noise_and_gain():
    """Reflectivity scatters by its sigma around a level that each laser has for itself."""
    out = seen({"reflectivity_noise": 1.5, "gain_spread": 0.05}, 10.0, 0.5).reflectivity[..., 0]
    level = out.mean(axis=0)
    assert (out - level).std() == pytest.approx(np.hypot(1.5, 1 / np.sqrt(12)), rel=0.03)
    assert 0.5 < level.std() < 5
    assert out.max() <= 100


@pytest.mark.parametrize(("range_m", "reflectance"), [(36, 0.1), (40, 0.1), (44, 0.1), (60, 0.2), (86, 0.5)])
def test_weak_echoes_are_seen_with_their_probability(range_m, reflectance):
    """The share of pulses seen is Phi of amplitude less threshold over noise, one half at the range of 10
    % (chi-square)."""
    out = seen({"weak_echoes_lost": True}, float(range_m), reflectance).distance_m[..., 0] > 0
    threshold = 0.1 / 40.0**2
    expected = stats.norm.cdf((reflectance / range_m**2 - threshold) / (threshold / 6)) * out.size
    found = out.sum()
    chi2 = (found - expected) ** 2 / expected + (found - expected) ** 2 / (out.size - expected)
    assert chi2 < stats.chi2.isf(0.001, 1)
    assert range_m != 40 or 0.48 < out.mean() < 0.52


def test_grazing_and_partly_hit_targets_drop_out():
    """A target seen at right angles is lost when grazed, and when a tenth of the beam is on it."""
    unit = detector({"weak_echoes_lost": True})
    for ranges, kinds, cosine, share in (
        ([50.0], [0], 1.0, 1.0),
        ([50.0], [0], 0.1, 0.0),
        ([50.0] + 9 * [np.inf], [0] + 9 * [NO_SURFACE], 1.0, 0.0),
    ):
        out = detect(firings(8), pulses(8, ranges, kinds, cosine), table(0.5), unit, truth=False)
        assert (out.distance_m[..., 0] > 0).mean() == share


def test_no_returns_show_a_constant_of_their_laser():
    """Records without a return carry the constant code of their laser, up to 255, if the setting asks for
    it; else 0."""
    silent = seen({"no_return_reflectivity": True}, np.inf, k=50)
    assert (silent.distance_m == 0).all()
    codes = silent.reflectivity[..., :2]
    assert (codes == codes[0, :, :1]).all()
    assert (codes[0, :, 0] == np.floor(no_return_reflectivity(1, 16, None))).all()
    assert len(np.unique(codes)) > 4
    assert no_return_reflectivity(1, 999, 100.0).max() == 255.0
    assert not seen({}, np.inf, k=8).reflectivity.any()
    assert (seen({"no_return_reflectivity": True}, 10.0, k=8).reflectivity[..., :2] == 20).all()


def test_presets_are_what_they_say():
    """`ideal` has no error, `datasheet` stays within 3 cm at two sigmas, own keys count, and a line names
    the preset and what it has become."""
    section = Noise(preset="typical", range_bias_m=0.0)
    assert section.summary == (
        "typical: 6.5 mm white, 0 mm bias per laser, 0.02 deg, 1.5 counts and 3 % on reflectivity, weak "
        "echoes lost"
    )
    ideal = Noise(preset="ideal")
    assert not any(ideal.model_dump(exclude={"preset"}).values())
    sheet = Noise(preset="datasheet")
    assert 2 * np.hypot(sheet.range_noise_m, sheet.range_bias_m) == pytest.approx(0.03, abs=0.001)
    assert Noise(preset="ideal", range_noise_m=0.02).range_noise_m == 0.02

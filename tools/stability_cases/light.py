"""Light at its limits: edges of range, dark and glaring surfaces, wide beams, merging echoes, thick air."""

from collections.abc import Iterator
from functools import partial

import numpy as np
from mpmath import exp, mp, mpf, quad, sqrt

from stability_cases.case import Row, case, refusal
from stability_cases.lab import PULSES, beam, detect_pulses, faces, open_scene, pulses, wall
from vlp16emu.packets import DISTANCE_LSB_M, LASERS, data_fields, pack_data
from vlp16emu.raycast.beam import Footprint
from vlp16emu.raycast.settings import Beam
from vlp16emu.returns.detect import detect
from vlp16emu.returns.detector import UnitDetector
from vlp16emu.returns.settings import Detector, Noise, Weather
from vlp16emu.returns.weather import fog_extinction_per_m, rain_extinction_per_m
from vlp16emu.scenario import load
from vlp16emu.types import F8, I8, NO_SURFACE, SURFACE, Firings, Hits, ReturnMode, Returns, SensorModel

_FLOAT32 = 2.0**-23
_FIRST_M = 40.0
_MERGED_M = 1.1e-3  # what merging of sub-rays may move a peak by: vlp16emu/returns/echoes.py


def _ahead(count: int) -> Firings:
    return pulses(np.zeros((count, 3)), np.tile([1.0, 0.0, 0.0], (count, 1)))


def _codes(returns: Returns) -> I8:
    """Distances (k, 16) of the strongest returns as packets carry them, in steps of 2 mm."""
    packets = pack_data(returns, ReturnMode.STRONGEST, SensorModel.VLP_16)
    payloads = np.frombuffer(b"".join(packet.payload for packet in packets), np.uint8)
    codes = data_fields(payloads.reshape(len(packets), -1))["blocks"]["records"]["distance_lsb"]
    return codes.reshape(-1, LASERS).astype(np.int64)


@case("closed form in float64")
def edges_of_range() -> Iterator[Row]:
    """Walls from 0.4 to 131.2 m, by steps of 1 mm at both edges of range, 0.5 and 131.07 m, from packets."""
    range_m = np.concatenate(
        [np.linspace(0.4, 0.6, 192), np.linspace(0.6, 131.0, 1152), np.linspace(131.0, 131.2, 192)]
    )
    strip_m = 0.25
    y_m = strip_m * (np.arange(len(range_m)) - len(range_m) / 2)
    side = np.ones(len(range_m))
    corners = [(range_m, y_m, -side), (range_m, y_m + strip_m, -side)]
    corners += [(range_m, y_m + strip_m, side), (range_m, y_m, side)]
    scene = open_scene([faces(np.stack([np.column_stack(corner) for corner in corners], axis=1))])
    origin_m = np.column_stack([0 * y_m, y_m + strip_m / 2, 0 * y_m])
    returns = detect_pulses(scene, pulses(origin_m, np.tile([1.0, 0.0, 0.0], (len(y_m), 1))))
    found_m = _codes(returns).reshape(-1) * DISTANCE_LSB_M
    float32_m = range_m.astype(np.float32).astype(np.float64)
    inside = (float32_m >= 0.5) & (float32_m <= 131.07)
    error_m = np.abs(found_m - range_m)
    bound_m = DISTANCE_LSB_M / 2 + 131.07 * _FLOAT32
    yield Row("0.5 to 131.07 m: decoded, m", float(error_m[inside].max()), bound_m)
    edge_m = DISTANCE_LSB_M / 2 + 1e-5
    beyond = (range_m < 0.5 - edge_m) | (range_m > 131.07 + edge_m)
    yield Row("nearer or farther: returns", int(np.count_nonzero(found_m[beyond])), 0)


@case("closed form in float64")
def dark_and_glaring() -> Iterator[Row]:
    """Reflectances from 0 over subnormal float32 numbers to 1e30, with one ray and with a wide beam."""
    dark = 0.0, 1e-45, 1e-40, 1.2e-38, 1e-20
    for name, reflectances, code in (("dark", dark, 0), ("glaring", (1e4, 1e30), 255)):
        scenes = [open_scene([wall(10.0)], reflectance=reflectance) for reflectance in reflectances]
        lights = beam("none"), beam("adaptive")
        found = [detect_pulses(scene, _ahead(PULSES), light) for scene in scenes for light in lights]
        range_m = np.stack([out.distance_m[..., 0] for out in found])
        codes = np.stack([out.reflectivity[..., 0] for out in found]).astype(int)
        yield Row(f"{name}: range, m", float(np.abs(range_m - 10.0).max()), 1e-4)
        yield Row(f"{name}: code", int(np.abs(codes - code).max()), 0)
    sky = detect_pulses(open_scene([wall(-10.0)]), _ahead(PULSES), beam("adaptive"))
    yield Row("open sky: returns", int(np.count_nonzero(sky.distance_m)), 0)


def _two_plates(step_m: F8, *, pulse_ns: float, resolution_m: float) -> F8:
    """Return the echoes (n, 3) of pulses, half on a plate at 40 m and half on one `step_m` (n,) behind."""
    n = len(step_m)
    range_m = np.stack([np.full(n, _FIRST_M), _FIRST_M + step_m], axis=1).astype(np.float32)
    counts = np.full((n // LASERS, LASERS), 2, np.uint16)
    surface = np.tile(np.array([0, 1], np.uint32), n)
    hits = Hits(counts, range_m.ravel(), surface, np.ones(2 * n, np.float32))
    surfaces = np.zeros(2, SURFACE)
    surfaces["reflectance"] = 0.5
    detector = _perfect(Detector(pulse_ns=pulse_ns, resolution_m=resolution_m))
    found = detect(_ahead(n), hits, surfaces, detector, truth=False)
    return found.distance_m.reshape(-1, 3).astype(np.float64)


def _perfect(detector: Detector, weather: Weather | None = None, noise: Noise | None = None) -> UnitDetector:
    return UnitDetector.of_unit(
        detector,
        noise or Noise(preset="ideal"),
        weather or Weather(),
        seed=1,
        mode=ReturnMode.DUAL,
        min_range_m=0.5,
        max_range_m=131.07,
        elevation_deg=np.zeros(LASERS),
        power_up_ns=0,
    )


def _mode_m(step_m: float, sigma_m: float) -> float:
    """Return the highest mode of two Gaussian echoes, at 40 m and a step behind, by Newton's method."""
    with mp.workdps(30):
        s = mpf(sigma_m)
        d = mpf(step_m)
        first = mpf(_FIRST_M)
        near = 1 / first**2
        far = 1 / (first + d) ** 2
        x = mp.mpf(0) if step_m > 2 * sigma_m else d * far / (near + far)
        for _ in range(60):
            a = near * exp(-((x / s) ** 2) / 2)
            b = far * exp(-(((x - d) / s) ** 2) / 2)
            slope = a * x + b * (x - d)
            bend = a * (1 - (x / s) ** 2) + b * (1 - ((x - d) / s) ** 2)
            x -= slope / bend if bend > 0 else slope / (a + b)
        return float(first + x)


@case("mpmath, 30 digits: the mode of two Gaussians")
def steps_inside_a_pulse() -> Iterator[Row]:
    """Two plates 0 to 3 sigmas of a pulse of 1, 6 and 20 ns apart: one hump becomes flat, then splits."""
    for pulse_ns in (1.0, 6.0, 20.0):
        sigma_m = _perfect(Detector(pulse_ns=pulse_ns)).constants.sigma_m
        step_m = sigma_m * np.linspace(0.0, 3.0, 2 * LASERS)
        # Where a hump splits its top is flat to the fourth order, and rounding alone moves it.
        flat = np.abs(step_m / sigma_m - 2) < 0.12
        found_m = _two_plates(step_m, pulse_ns=pulse_ns, resolution_m=0.0)[:, 0]
        true_m = np.array([_mode_m(step, sigma_m) for step in step_m.astype(np.float32).tolist()])
        error_m = np.abs(found_m - true_m)
        yield Row(f"{pulse_ns:g} ns: range of the strongest, m", float(error_m[~flat].max()), _MERGED_M)
        relative = float((error_m[flat] / sigma_m).max())
        yield Row(f"{pulse_ns:g} ns, where it splits: range, sigmas", relative, 0.01)


@case("closed form: the resolution")
def merging_echoes() -> Iterator[Row]:
    """Two plates drawn apart by tenths of a millimetre about the resolution of 1.4 m."""
    resolution_m = Detector().resolution_m
    step_m = resolution_m + 1e-4 * (np.arange(8 * PULSES) - 4 * PULSES)
    found_m = _two_plates(step_m, pulse_ns=6.0, resolution_m=resolution_m)
    two = (found_m[:, 1] != found_m[:, 0]) | (found_m[:, 2] > 0)
    yield Row("changes from one echo to two, less one", abs(int(np.diff(two).sum()) - 1), 0)
    other_m = np.where(found_m[:, 2] > 0, found_m[:, 2], found_m[:, 1])
    apart_m = float(np.abs(other_m - found_m[:, 0])[two].min())
    yield Row("least gap of two, less the resolution, m", abs(apart_m - resolution_m), 1e-3)


def _light(model: str, rays: int, spot_mm: float, divergence_mrad: float) -> Footprint:
    divergence = divergence_mrad, divergence_mrad
    section = Beam(model=model, spot_mm=(spot_mm, spot_mm), divergence_mrad=divergence)
    return Footprint(section, seed=7, resolution_m=1.0).with_settings(rays=rays)


@case("closed form in float64 without width; 4096 sub-rays with it", is_slow=True)
def widths_of_beams() -> Iterator[Row]:
    """Beams without width, of a nanometre, and of 100 mm and 50 mrad, which are 5 m wide at 100 m."""
    floor = faces(np.array([[(-200, -200, -3), (200, -200, -3), (200, 200, -3), (-200, 200, -3)]]))
    scene = open_scene([floor, wall(60.0, 3.0)])
    down_rad = np.linspace(np.radians(2.5), np.radians(15), 2 * PULSES)
    turn_rad = np.linspace(0.0, 6.0, 2 * PULSES)
    level = np.cos(down_rad)
    direction = np.column_stack([level * np.cos(turn_rad), level * np.sin(turn_rad), -np.sin(down_rad)])
    firings = pulses(np.zeros((len(down_rad), 3)), direction)
    line_m = detect_pulses(scene, firings).distance_m[..., 0]
    for name, spot_mm, divergence_mrad in (("no width", 0.0, 0.0), ("1 nm, 1e-9 mrad", 1e-6, 1e-9)):
        for model in ("fixed", "adaptive"):
            light = _light(model, 64, spot_mm, divergence_mrad)
            wide_m = detect_pulses(scene, firings, light).distance_m[..., 0]
            yield Row(f"{name}, {model}: moved from one ray's, m", float(np.abs(wide_m - line_m).max()), 1e-4)
    truth = detect_pulses(scene, firings, _light("fixed", 4096, 100.0, 50.0))
    for model in ("fixed", "adaptive"):
        wide = detect_pulses(scene, firings, _light(model, 64, 100.0, 50.0))
        off_m = wide.distance_m[..., 0].astype(np.float64) - truth.distance_m[..., 0]
        same = np.abs(off_m) < 1.0  # another echo in its place is no error of its range
        codes = wide.reflectivity[..., 0].astype(float) - truth.reflectivity[..., 0]
        yield Row(f"50 mrad, {model}: mean of ranges, m", abs(float(off_m[same].mean())), Beam().target_m)
        yield Row(f"50 mrad, {model}: mean of codes", abs(float(codes[same].mean())), 0.5)
    yield refusal("a beam of one ray", partial(load, "static_bench", ["beam.rays=1"]), "from 2 to")


def _clutter_share(extinction: float, sigma_m: float) -> float:
    """Return the chance that the air alone gives an echo, an integral of the lidar equation."""
    with mp.workdps(20):
        a = mpf(extinction)
        air = mp.pi * a / mpf("18.2") * sqrt(2 * mp.pi) * mpf(sigma_m)
        least = mpf("0.1") / 40**2  # threshold: a wall of 10 % at 40 m

        def seen(r: mpf) -> mpf:
            return a * exp(-a * r) * exp(-least * r * r * exp(2 * a * r) / air)

        return float(quad(seen, [mpf("0.5"), 2, 10, 40, mpf("131.07")]))


@case("mpmath, 20 digits: integral of the lidar equation")
def thick_air() -> Iterator[Row]:
    """Fog of 10 m, whose transmission there and back falls to 1e-44, fog of 100 m, rain of 200 mm/h."""
    count = 125 * 24
    hits = Hits(
        np.ones((count, LASERS), np.uint16),
        np.full(count * LASERS, np.inf, np.float32),
        np.full(count * LASERS, NO_SURFACE, np.uint32),
        np.zeros(count * LASERS, np.float32),
    )
    surfaces = np.zeros(1, SURFACE)
    for name, weather, extinction in (
        ("fog of 10 m", Weather(visibility_m=10.0), fog_extinction_per_m(10.0)),
        ("fog of 100 m", Weather(visibility_m=100.0), fog_extinction_per_m(100.0)),
        ("rain of 200 mm/h", Weather(rain_mm_h=200.0), rain_extinction_per_m(200.0)),
    ):
        detector = _perfect(Detector(), weather)
        out = detect(_ahead(count * LASERS), hits, surfaces, detector, truth=False)
        share = float((out.distance_m[..., 0] > 0).mean())
        true = _clutter_share(extinction, detector.constants.sigma_m)
        sigma = float(np.sqrt(true * (1 - true) / (count * LASERS)))
        yield Row(f"{name}: share of echoes of the air, standard errors", abs(share - true) / sigma, 4)
        sound = np.isfinite(out.distance_m) & (out.distance_m >= 0) & (out.distance_m <= 131.07)
        yield Row(f"{name}: returns out of limits", int((~sound).sum()), 0)

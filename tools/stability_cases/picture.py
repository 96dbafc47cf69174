"""Errors where they say more as a curve than as one number."""

from pathlib import Path

import numpy as np

from stability_cases.coordinates import path_shift_m
from stability_cases.faces import grazing_error_m
from stability_cases.poses import gimbal_errors
from stability_cases.straps import DAMPINGS, slackest_hz, sway_errors

_COLOURS = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#000000"  # Okabe and Ito, for the colour blind
_BOUND = {"color": "#888888", "linestyle": "--", "label": "bound"}


def draw(path: Path) -> None:
    """Draw errors over pitch, frequency of straps, incidence, and distance from the origin."""
    import matplotlib as mpl

    mpl.use("agg")
    import matplotlib.pyplot as plt

    figure, ((pole, straps), (grazed, far)) = plt.subplots(2, 2, figsize=(10, 7), layout="constrained")
    for rate_hz, colour in ((20, _COLOURS[1]), (100, _COLOURS[0])):
        pitch_deg, error_rad, _ = gimbal_errors(rate_hz)
        edges_deg = np.arange(-10.0, 191.0, 5.0)
        which = np.digitize(pitch_deg, edges_deg)
        largest = [error_rad[which == n].max() for n in range(1, len(edges_deg))]
        pole.plot(edges_deg[:-1] + 2.5, largest, ".-", color=colour, label=f"poses at {rate_hz} Hz, largest")
    pole.axvline(90.0, color="#888888", lw=0.8)
    pole.set_ylim(1e-12, 1e-6)
    pole.set(title="Poses through the pole", ylabel="error of rotation, rad")
    pole.set_xlabel("pitch, deg (Euler angles jump at 90)")
    for damping, colour in zip(DAMPINGS, _COLOURS, strict=True):
        hz = np.geomspace(slackest_hz(damping), 1e9, 19)
        errors_m = [sway_errors(f, damping)[0] for f in hz.tolist()]
        straps.plot(hz, errors_m, ".-", color=colour, label=f"damping {damping:g}")
    straps.axhline(1e-10, **_BOUND | {"label": "bound for damping from 0.1"})
    straps.set(title="Straps driven by steps", ylabel="error of sway, m", xscale="log")
    straps.set_xlabel("natural frequency, Hz")
    from_level_deg = np.geomspace(1e-4, 60.0, 24)
    for name, worst, colour in (("largest", np.max, _COLOURS[1]), ("median", np.median, _COLOURS[0])):
        errors_m = [float(worst(grazing_error_m(90.0 - angle))) for angle in from_level_deg.tolist()]
        grazed.plot(from_level_deg, errors_m, ".-", color=colour, label=name)
    grazed.axhline(4 * 100 * 2.0**-23, **_BOUND)
    grazed.set(title="Floor at grazing incidence, 10 to 100 m away", ylabel="error of range, m", xscale="log")
    grazed.set_xlabel("angle between pulse and floor, deg")
    away_m = np.geomspace(1.0, 9e5, 24)
    # A moved path is equal to the last bit at some places; half a step stands for it.
    moved_m = [max(path_shift_m(float(a)), float(np.spacing(a)) / 2) for a in away_m]
    far.plot(away_m, moved_m, ".-", color=_COLOURS[0], label="largest")
    far.plot(away_m, 2 * np.spacing(away_m), **_BOUND)
    far.set(title="A path moved away", xlabel="distance from the origin, m", ylabel="moved, m", xscale="log")
    for panel in (pole, straps, grazed, far):
        panel.set_yscale("log")
        panel.grid(alpha=0.3)
        panel.legend(fontsize=8)
    figure.savefig(path, dpi=80)

"""Check of a bag from any recorder for a SLAM program; findings name the parameter to set."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from vlp16emu.extras.slam.configure import Program, configurations_beside, programs_named
from vlp16emu.extras.slam.facts import read_facts
from vlp16emu.extras.slam.held import values_held, values_set
from vlp16emu.extras.slam.measures import (
    EARLY_S,
    IMU_HZ,
    SWEEP_S,
    TURNS_DEG,
    cloud_values,
    frame_values,
    imu_values,
)
from vlp16emu.trees import Tree

_TILT_DEG = 30.0  # largest tilt of a body that a person carries
_SLOW_HZ = 100.0  # IMU rate below which programs deskew poorly
_BEAMS = 16
_FAR_M = 300.0  # median range; a VLP-16 reaches 131 m, and sensors for cars 300 m
_CLOUD = "cloud-topic"


@dataclass(frozen=True, slots=True)
class Unfit:
    """Reason why a bag is not fit for a program, with the configuration beside it or in `protocol/slam`."""

    program: str
    rule: str
    found: str
    needs: str  # parameter to set, or requirement of the bag; after a semicolon the consequence otherwise

    def __str__(self) -> str:
        remedy, _, otherwise = self.needs.partition("; ")
        return f"{self.program}: {self.rule}: {self.found}; needs {remedy}, otherwise {otherwise}"


@dataclass(frozen=True, slots=True)
class Fitness:
    """Summary of a bag, and its fitness for programs."""

    summary: Tree
    programs: tuple[str, ...]
    findings: tuple[Unfit, ...]
    configurations: dict[str, tuple[str, ...]]  # names of the files beside the bag that were read, by program

    def of(self, program: str) -> list[Unfit]:
        """Return the findings of a program."""
        return [finding for finding in self.findings if finding.program == program]


class _Row(NamedTuple):
    """A row of the table of rules."""

    rule: str
    is_broken: Callable[[Any, Program], Any]  # true if the values of a bag break it
    found: str  # format string of the finding, with names of values
    after: str = ""  # rules that hold if the measurement behind this one is sound
    like: str = ""  # rule whose programs, and whose texts if `needs` is empty, are those of this one
    needs: str = ""  # text as in `programs.toml`, the same for all programs

    def text(self, program: Program) -> str:
        """Return the need of a program; empty if the rule does not concern it."""
        text = program.needs.get(self.like or self.rule, "")
        return text and (self.needs or text)


ROWS = (
    _Row("cloud-topic", lambda v, _: v["topic"] != "/velodyne_points", "point clouds are on {topic}"),
    _Row("imu-topic", lambda v, _: v["imu"] not in ("", "/imu/data"), "IMU messages are on {imu}", "no-imu"),
    _Row("no-imu", lambda v, _: not v["samples"], "there are no IMU messages"),
    _Row(
        "no-points",
        lambda v, _: v["empty"] == v["clouds"],
        "no cloud has points with coordinates",
        like=_CLOUD,
        needs="points; there is nothing to register",
    ),
    _Row(
        "empty-clouds",
        lambda v, _: v["empty"],
        "{empty} of {clouds} clouds have no points",
        "no-points",
        _CLOUD,
        "points in each cloud; the pose is lost there",
    ),
    _Row(
        "point-unit",
        lambda v, _: v["range_m"] > _FAR_M,
        "the median range is {range_m:.4g}, as in millimetres",
        "no-points",
        _CLOUD,
        "points in metres; filters by distance drop them, or the map is a thousand times too large",
    ),
    _Row(
        "stamps",
        lambda v, _: v["same"],
        "{same} of {clouds} clouds have the stamp of the cloud before",
        like=_CLOUD,
        needs="each cloud once, with a stamp of its own; clouds are dropped, or registered without motion",
    ),
    _Row(
        "one-cloud",
        lambda v, _: v["clouds"] < 2,
        "there is one cloud",
        like=_CLOUD,
        needs="a bag of several clouds; there is nothing to register it with",
    ),
    _Row(
        "turn",
        lambda v, _: v["is_no_turn"],
        "a message covers {message_deg:.0f} deg of azimuth",
        "no-points",
        _CLOUD,
        "messages of one turn (rpm and cut_angle of the driver as the sensor turns); "
        "it takes each message for a whole turn",
    ),
    _Row("no-time", lambda v, _: not v["name"], "points have no time field, only {fields}"),
    _Row("times", lambda v, _: v["times"], "{times}", "no-time no-points", "no-time"),
    _Row("time-name", lambda v, _: v["name"] != "time", "point times are in the field `{name}`", "no-time"),
    _Row("time-type", lambda v, _: v["time_type"] != "float32", "point times are {time_type}", "no-time"),
    _Row(
        "time-span",
        lambda v, _: v["is_other_span"],
        "point times span {span:.4g}, but messages are {step_s:.4g} s apart",
        "no-time no-points times stamps one-cloud turn",
        "no-time",
        "times of all points of a sweep, in s, ms, us or ns; points are deskewed by wrong poses",
    ),
    _Row(
        "time-unit",
        lambda v, _: v["unit"] != "s",
        "point times are in {unit}: a sweep spans {span:g}",
        "no-time no-points times time-span",
    ),
    _Row(
        "time-zero",
        lambda v, _: abs(v["early_s"]) > EARLY_S,
        "point times begin {early_s:+.4g} s from the stamp instead of at 0",
        "no-time no-points times time-span",
    ),
    _Row(
        "time-last",
        lambda v, _: v["late_scans"],
        "in {late_scans} scans the last point is not the latest",
        "no-time no-points times time-span",
    ),
    _Row("ring", lambda v, _: v["ring_type"] != "uint16", "`ring` is {ring_type} instead of uint16"),
    _Row("rings", lambda v, _: v["rings_fault"], "`ring` has {rings_fault}", "no-points", "ring"),
    _Row("ring-order", lambda v, _: v["misordered"], "ring {misordered}", "no-points rings"),
    _Row("beams", lambda v, _: v["rings"] not in (0, _BEAMS), "there are {rings} rings", "no-points rings"),
    _Row("density", lambda v, _: v["sparse"], "{sparse} clouds hold NaN, or are not marked as dense"),
    _Row(
        "sweep",
        lambda v, _: abs(v["sweep_s"] / SWEEP_S - 1) > 0.05,
        "a sweep takes {sweep_s:.4g} s",
        "no-points stamps one-cloud turn time-span",
    ),
    _Row(
        "cloud-gaps",
        lambda v, _: v["gaps"],
        "{gaps} gaps between scans, up to {gap_s:.3g} s",
        "stamps one-cloud turn time-span",
    ),
    _Row(
        "imu-values",
        lambda v, _: v["no_numbers"],
        "{no_numbers} of {samples} IMU messages hold NaN or infinite values",
        "no-imu",
        "no-imu",
        "numbers in all messages; the pose is NaN from there on",
    ),
    _Row(
        "imu-stamps",
        lambda v, _: v["imu_same"],
        "{imu_same} of {samples} IMU messages have the stamp of the message before",
        "no-imu",
        "no-imu",
        "each message once, with a stamp of its own; steps of no duration are integrated",
    ),
    _Row(
        "gravity-unit",
        lambda v, _: not 8 < v["norm"] < 12,
        "accelerations have the median {norm:.3g}",
        "no-imu imu-values",
    ),
    _Row(
        "gyro-unit",
        lambda v, _: v["rate_95"] > 12,
        "angular rates reach {rate_95:.3g}, as in degrees per second",
        "no-imu imu-values",
    ),
    _Row(
        "gravity-axis",
        lambda v, _: v["lean_deg"] > _TILT_DEG,
        "gravity is {lean_deg:.0f} deg off the body's vertical",
        "no-imu imu-values",
    ),
    _Row(
        "imu-rate",
        lambda v, _: abs(v["hz_imu"] / IMU_HZ - 1) > 0.02,
        "the IMU has {hz_imu:.1f} samples a second",
        "no-imu imu-stamps",
    ),
    _Row(
        "imu-slow",
        lambda v, _: v["hz_imu"] < _SLOW_HZ * 0.98,
        "the IMU has {hz_imu:.1f} samples a second",
        "no-imu imu-stamps",
    ),
    _Row(
        "imu-gaps",
        lambda v, _: v["imu_gaps"] or v["imu_back"],
        "{imu_gaps} gaps between IMU samples, up to {imu_gap_s:.3g} s, and {imu_back} steps back in time",
        "no-imu imu-stamps",
    ),
    _Row("attitude", lambda v, _: v["levelled"] < 1, "IMU messages have no orientation", "no-imu"),
    _Row(
        "attitude-fixed",
        lambda v, _: v["is_fixed_attitude"] and v["turned_imu_deg"] > TURNS_DEG,
        "the orientation never changes, while angular rates turn by {turned_imu_deg:.0f} deg",
        "no-imu attitude imu-values imu-stamps",
        "attitude",
    ),
    _Row("covariance", lambda v, _: v["unknown"], "covariances of rate or acceleration begin with -1"),
    _Row(
        "clock",
        lambda v, _: v["inside"] < 0.5 or v["back"],
        "{inside:.0%} of the scans lie within the time of the IMU, which begins {offset_s:+.3f} s after them;"
        " {back} stamps go back",
        "no-imu stamps imu-stamps",
    ),
    _Row(
        "imu-frame",
        lambda v, _: v["is_apart"],
        "no transforms connect {lidar} and {imu_frame}",
        "no-imu",
        "extrinsics",
        "the measured extrinsics of lidar and IMU; a lever arm that is not known shifts the map",
    ),
    _Row(
        "extrinsics",
        lambda v, _: v["apart_m"] > 1e-3 or v["turned_deg"] > 0.1,
        "lidar and IMU are {apart_m:.3f} m and {turned_deg:.1f} deg apart",
        "no-imu imu-frame",
    ),
    _Row("frames", lambda v, _: v["tree"], "{tree}"),
    _Row(
        "frame-base",
        lambda v, _: v["root"] != "base_link",
        "the root of the frames is {root} instead of base_link",
    ),
    _Row("tf-map", lambda v, _: v["edge"], "/tf holds {edge}, which a SLAM program publishes too"),
    _Row(
        "rest",
        lambda v, program: v["rest_s"] < program.rest_s - 0.2,
        "{rest_s:.1f} s of rest at the start",
        "no-imu imu-values imu-stamps",
    ),
)
"""Rules in the order of findings. A rule applies to the programs that have a text for it in `programs.toml`;
it is not judged if a rule before it shows that its measurement is not sound."""


def fitness(path: Path, name: str) -> Fitness:
    """Check a bag against the needs of one program, or of all.

    A parameter is held against the configuration beside the bag, as `record --for` writes it, and without one
    against that of `protocol/slam`.

    Raises InputError if there is no such program, or a configuration cannot be read; CaptureError,
    MissingExtraError as in `read_facts`.
    """
    programs = programs_named(name)
    facts = read_facts(path)
    values = cloud_values(facts) | imu_values(facts) | frame_values(facts)
    keys = ("topic", "clouds", "points", "sweep_s", "imu", "samples", "hz_imu", "norm", "rest_s", "root")
    beside = {program.name: configurations_beside(path, program) for program in programs}
    return Fitness(
        {key: values[key] for key in keys},
        tuple(program.name for program in programs),
        tuple(
            finding for program in programs for finding in _findings(program, values, beside[program.name])
        ),
        {program: tuple(texts) for program, texts in beside.items()},
    )


def _findings(program: Program, values: Tree, texts: dict[str, str]) -> list[Unfit]:
    """Return the findings of a program whose configuration files are `texts`, by name."""
    broken = set[str]()
    findings = []
    for row in ROWS:
        if not broken.isdisjoint(row.after.split()):
            continue
        is_broken = bool(row.is_broken(values, program))
        if is_broken:
            broken.add(row.rule)
        text = row.text(program)
        needs = text.format_map(values)
        found = row.found.format_map(values)
        wanted = values_set(needs)
        held = values_held(wanted, texts)
        if held:
            wrong = [entry for entry in held if not entry.is_right]
            is_broken = bool(wrong) and (is_broken or "{" in text)
            found += "".join(f", and {entry}" for entry in wrong[:1])
        if text and is_broken:
            findings.append(Unfit(program.name, row.rule, found, needs))
    return findings

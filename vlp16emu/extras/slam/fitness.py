"""Check of a bag from any recorder for a SLAM program; findings name the parameter to set."""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

from vlp16emu.extras.slam.configure import Program, configurations_beside, programs_named
from vlp16emu.extras.slam.facts import read_facts
from vlp16emu.extras.slam.held import parameters_held
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

    def findings_of(self, program: str) -> list[Unfit]:
        """Return the findings of a program."""
        return [finding for finding in self.findings if finding.program == program]


class Row(NamedTuple):
    """A row of `rules.toml`."""

    rule: str
    found: str  # format string of the finding, with names of values
    after: Sequence[str] = ()  # rules that hold if the measurement behind this one is sound
    like: str = ""  # rule whose programs, and whose texts if `needs` is empty, are those of this one
    needs: str = ""  # text as in `programs.toml`, the same for all programs

    def text(self, program: Program) -> str:
        """Return the need of a program; empty if the rule does not concern it."""
        text = program.needs.get(self.like or self.rule, "")
        return text and (self.needs or text)


_RULES = tomllib.loads(files(__package__).joinpath("rules.toml").read_text(encoding="utf-8"))
ROWS = tuple(Row(**row) for row in _RULES["rules"])
"""Rules in the order of findings."""


def broken_rules(values: Tree, program: Program) -> dict[str, bool]:
    """Return for each rule whether the values of a bag break it, measured soundly or not."""
    return {
        "cloud-topic": values["topic"] != "/velodyne_points",
        "imu-topic": values["imu"] not in ("", "/imu/data"),
        "no-imu": not values["samples"],
        "no-points": values["empty"] == values["clouds"],
        "empty-clouds": bool(values["empty"]),
        "point-unit": values["range_m"] > _FAR_M,
        "stamps": bool(values["same"]),
        "one-cloud": values["clouds"] < 2,
        "turn": bool(values["is_no_turn"]),
        "no-time": not values["name"],
        "times": bool(values["times"]),
        "time-name": values["name"] != "time",
        "time-type": values["time_type"] != "float32",
        "time-span": bool(values["is_other_span"]),
        "time-unit": values["unit"] != "s",
        "time-zero": abs(values["early_s"]) > EARLY_S,
        "time-last": bool(values["late_scans"]),
        "ring": values["ring_type"] != "uint16",
        "rings": bool(values["rings_fault"]),
        "ring-order": bool(values["misordered"]),
        "beams": values["rings"] not in (0, _BEAMS),
        "density": bool(values["sparse"]),
        "sweep": abs(values["sweep_s"] / SWEEP_S - 1) > 0.05,
        "cloud-gaps": bool(values["gaps"]),
        "imu-values": bool(values["no_numbers"]),
        "imu-stamps": bool(values["imu_same"]),
        "gravity-unit": not 8 < values["norm"] < 12,
        "gyro-unit": values["rate_95"] > 12,
        "gravity-axis": values["lean_deg"] > _TILT_DEG,
        "imu-rate": abs(values["hz_imu"] / IMU_HZ - 1) > 0.02,
        "imu-slow": values["hz_imu"] < _SLOW_HZ * 0.98,
        "imu-gaps": bool(values["imu_gaps"] or values["imu_back"]),
        "attitude": values["levelled"] < 1,
        "attitude-fixed": bool(values["is_fixed_attitude"] and values["turned_imu_deg"] > TURNS_DEG),
        "covariance": bool(values["unknown"]),
        "clock": bool(values["inside"] < 0.5 or values["back"]),
        "imu-frame": bool(values["is_apart"]),
        "extrinsics": bool(values["apart_m"] > 1e-3 or values["turned_deg"] > 0.1),
        "frames": bool(values["tree"]),
        "frame-base": values["root"] != "base_link",
        "tf-map": bool(values["edge"]),
        "rest": values["rest_s"] < program.rest_s - 0.2,
    }


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
    findings = list[Unfit]()
    for program in programs:
        findings += _findings(program, values, beside[program.name])
    return Fitness(
        summary={key: values[key] for key in keys},
        programs=tuple(beside),
        findings=tuple(findings),
        configurations={program: tuple(texts) for program, texts in beside.items()},
    )


def _findings(program: Program, values: Tree, texts: dict[str, str]) -> list[Unfit]:
    """Return the findings of a program whose configuration files are `texts`, by name."""
    is_broken = broken_rules(values, program)
    broken = set[str]()
    findings = []
    for row in ROWS:
        if not broken.isdisjoint(row.after):
            continue
        if is_broken[row.rule]:
            broken.add(row.rule)
        text = row.text(program)
        needs = text.format_map(values)
        found = row.found.format_map(values)
        is_unfit = is_broken[row.rule]
        parameters = parameters_held(needs, texts)
        if parameters:
            wrong = [parameter for parameter in parameters if not parameter.is_right]
            is_unfit = bool(wrong) and (is_unfit or "{" in text)
            found += "".join(f", and {parameter}" for parameter in wrong[:1])
        if text and is_unfit:
            findings.append(Unfit(program.name, row.rule, found, needs))
    return findings

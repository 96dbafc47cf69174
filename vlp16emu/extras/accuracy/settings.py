"""The settings whose errors are measured: the light of a pulse, and how long a pose is held."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from vlp16emu.engine import Unit, beam_of
from vlp16emu.extras.accuracy.curve import Kind
from vlp16emu.packets import SEQUENCES_PER_PACKET
from vlp16emu.raycast.beam import Footprint
from vlp16emu.scenario import Scenario
from vlp16emu.types import Poses, ReturnMode

PosesAt = Callable[[NDArray[np.int64]], Poses]
Model = Literal["adaptive", "fixed", "none", "angle", "offset"]

_COUNTS = (4, 8, 16, 32, 64, 128)
_TIMES_TARGET = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Targets of adaptive beams, over that of the scene."""


@dataclass(frozen=True, slots=True)
class BeamSetting:
    """One way to follow the light of a pulse."""

    kind: Kind
    name: str
    """As `--set` takes it."""
    in_use: bool
    beam: Footprint


@dataclass(frozen=True, slots=True)
class PoseRate:
    """One way to give pulses their poses."""

    name: str
    in_use: bool
    poses_at: PosesAt


def beam_settings(scenario: Scenario, seed: int) -> list[BeamSetting]:
    """List one ray, the paper's beam errors, fixed counts and adaptive targets, that of the scene among them."""
    section = scenario.beam
    counts = sorted({*_COUNTS, section.rays} if section.model == "fixed" else _COUNTS)
    targets_m = sorted({min(times * section.target_m, 1.0) for times in _TIMES_TARGET}, reverse=True)

    def setting(kind: Kind, model: Model, **own: float) -> BeamSetting:
        changed = section.model_copy(update={"model": model, **own})
        keys: dict[str, object] = {"model": model} | {key: f"{value:.4g}" for key, value in own.items()}
        return BeamSetting(
            kind,
            " ".join(f"beam.{key}={value}" for key, value in keys.items()),
            in_use=changed == section,
            beam=beam_of(scenario.model_copy(update={"beam": changed}), seed),
        )

    return [
        setting(Kind.ONE_RAY, "none"),
        setting(Kind.BEAM_ERROR, "angle"),
        setting(Kind.BEAM_ERROR, "offset"),
        *(setting(Kind.FIXED, "fixed", rays=count) for count in counts),
        *(setting(Kind.ADAPTIVE, "adaptive", target_m=target_m) for target_m in targets_m),
    ]


def pose_rates(unit: Unit) -> list[PoseRate]:
    """List a pose per pulse, per firing sequence and per packet; nothing where nothing moves."""
    if not unit.motion.moves:
        return []
    sequence_ns, start_ns = unit.head.beams.sequence_ns, unit.head.start_ns
    packet_ns = SEQUENCES_PER_PACKET[ReturnMode(unit.section.return_mode)] * sequence_ns
    poses_at, holds_ns = unit.motion.poses_at, {"firing sequence": sequence_ns, "packet": packet_ns}
    held = [PoseRate(f"pose per {what}", False, _held(poses_at, start_ns, ns)) for what, ns in holds_ns.items()]
    return [PoseRate("pose per pulse", in_use=True, poses_at=poses_at), *held]


def _held(poses_at: PosesAt, start_ns: int, hold_ns: int) -> PosesAt:
    """Give poses that stay for `hold_ns` what they were at its begin."""

    def held(t_ns: NDArray[np.int64]) -> Poses:
        begin_ns, whose = np.unique((t_ns - start_ns) // hold_ns * hold_ns + start_ns, return_inverse=True)
        poses = poses_at(begin_ns)
        return Poses(t_ns, poses.world_R_body[whose], poses.world_p_body_m[whose])

    return held

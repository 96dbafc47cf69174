"""Extrinsics of a device on its carrier: lever arm, tilt, and an optional spinning stage."""

import math

import numpy as np

from vlp16emu.elementary import matmul, matvec, norm
from vlp16emu.kernels.compiler import array_kernel
from vlp16emu.motion.pose import Kinematics, Motion
from vlp16emu.motion.settings import Mount
from vlp16emu.random import Purpose, normal
from vlp16emu.rotation import rotation
from vlp16emu.trig import cos_sin
from vlp16emu.types import F8, I8, Poses
from vlp16emu.units import S_NS


def device_motion(carrier: Motion, mount: Mount, start_ns: int) -> Motion:
    """Return the motion of a device on its carrier; the carrier's own motion for a trivial mount."""
    return carrier if mount.trivial else MountedMotion(carrier, mount, start_ns)


def true_mount(mount: Mount, seed: int, device: int) -> Mount:
    """Return the true mount of device 0, 1, ..., whose nominal mount is `mount`."""
    if not mount.has_errors:
        return mount
    drawn = normal(seed, Purpose.MOUNT, 0, 6, device)
    arm_m = (drawn[:3] * (1e-3 * mount.error_mm)).tolist()
    turns_deg = (drawn[3:] * mount.error_deg).tolist()
    angles = "yaw_deg", "pitch_deg", "roll_deg"
    moved: dict[str, object] = {
        name: getattr(mount, name) + turn for name, turn in zip(angles, turns_deg, strict=True)
    }
    moved["lever_arm_m"] = tuple(given + off for given, off in zip(mount.lever_arm_m, arm_m, strict=True))
    return mount.model_copy(update=moved)


class MountedMotion:
    """Motion of a device on a carrier; a spinning stage is at angle 0 at `start_ns`, UTC."""

    def __init__(self, carrier: Motion, mount: Mount, start_ns: int) -> None:
        self._carrier = carrier
        self._start_ns = start_ns
        self._arm_m = np.array(mount.lever_arm_m)
        tilt = rotation(mount.yaw_deg, mount.pitch_deg, mount.roll_deg)
        axis = np.array(mount.spin_axis) / norm(np.array(mount.spin_axis))
        across = np.cross(np.eye(3), axis)
        # Rodrigues: tilt, its product with the axis' cross matrix, and with that matrix squared.
        self._tilts = np.stack([tilt, matmul(across, tilt), matmul(matmul(across, across), tilt)])
        self._spin_hz = mount.spin_hz
        self._spin_rad_s = 2.0 * math.pi * mount.spin_hz * axis
        self.run_time_s = carrier.run_time_s
        self.moves = carrier.moves or mount.spin_hz != 0.0

    def poses_at(self, t_ns: I8) -> Poses:
        """Return poses of the device at UTC instants (n,); a single pose if nothing moves."""
        carrier = self._carrier.poses_at(t_ns)
        return self._mount_on(carrier, t_ns if self.moves else carrier.t_ns)[0]

    def kinematics_at(self, t_ns: I8) -> Kinematics:
        """Return poses of the device at UTC instants (n,) with the derivatives of the same function."""
        body = self._carrier.kinematics_at(t_ns)
        poses, turns = self._mount_on(body, t_ns)
        w = body.body_w_rad_s
        alpha = body.body_alpha_rad_s2
        arm = self._arm_m
        spin = self._spin_rad_s
        swing = np.cross(w, arm)
        device_R_body = np.broadcast_to(turns, (len(t_ns), 3, 3)).swapaxes(1, 2)
        return Kinematics(
            t_ns,
            poses.world_R_body,
            poses.world_p_body_m,
            world_v_body_m_s=body.world_v_body_m_s + matvec(body.world_R_body, swing),
            world_a_body_m_s2=body.world_a_body_m_s2
            + matvec(body.world_R_body, np.cross(alpha, arm) + np.cross(w, swing)),
            body_w_rad_s=matvec(device_R_body, w + spin),
            # The stage's axis is fixed in the carrier, so the carrier's rate turns it.
            body_alpha_rad_s2=matvec(device_R_body, alpha + np.cross(w, spin)),
        )

    def _mount_on(self, body: Poses, t_ns: I8) -> tuple[Poses, F8]:
        """Return poses of the device on a carrier, and its rotations (n, 3, 3) on it; (1, 3, 3) if fixed."""
        turns = self._tilts[:1]
        poses = Poses(t_ns, np.empty((len(t_ns), 3, 3)), np.empty((len(t_ns), 3)))
        if self._spin_hz != 0.0:
            elapsed_ns = t_ns - self._start_ns
            turns = np.empty((len(t_ns), 3, 3))
            _spin(elapsed_ns // S_NS, elapsed_ns % S_NS, self._spin_hz, self._tilts, turns)
        _mount(
            body.world_R_body,
            body.world_p_body_m,
            turns,
            self._arm_m,
            poses.world_R_body,
            poses.world_p_body_m,
        )
        return poses, turns


@array_kernel
def _spin(whole_s: I8, rest_ns: I8, spin_hz: float, tilts: F8, out: F8) -> None:
    """Fill rotations (n, 3, 3): the tilt, rotated about the axis by Rodrigues' formula."""
    for i in range(len(out)):
        # Seconds and the rest separately: after days their product would lose the last digits of the angle.
        revolutions = spin_hz * whole_s[i] % 1.0 + spin_hz * (rest_ns[i] * 1.0e-9)
        c, s = cos_sin(2.0 * math.pi * revolutions)
        for a in range(3):
            for b in range(3):
                out[i, a, b] = tilts[0, a, b] + s * tilts[1, a, b] + (1.0 - c) * tilts[2, a, b]


@array_kernel
def _mount(world_R_body: F8, world_p_body_m: F8, body_R_device: F8, arm_m: F8, R: F8, p_m: F8) -> None:
    """Fill world_R_device and world_p_device; a single carrier pose or rotation applies to all."""
    for i in range(len(R)):
        n = i if len(world_R_body) > 1 else 0
        m = i if len(body_R_device) > 1 else 0
        for a in range(3):
            row = world_R_body[n, a]
            turn = body_R_device[m]
            p_m[i, a] = world_p_body_m[n, a] + row[0] * arm_m[0] + row[1] * arm_m[1] + row[2] * arm_m[2]
            for b in range(3):
                R[i, a, b] = row[0] * turn[0, b] + row[1] * turn[1, b] + row[2] * turn[2, b]

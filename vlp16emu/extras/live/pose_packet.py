"""The datagram that brings a pose of the carrier into a live run; its bytes stand in `protocol/pose_packet.toml`."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from vlp16emu.errors import PacketError

_LAYOUT = struct.Struct("<4sBBHq7d")
_MAGIC, _VERSION, _HAS_TIME = b"POSE", 1, 1
_HEAD = _MAGIC + bytes([_VERSION])
POSE_BYTES = _LAYOUT.size


@dataclass(frozen=True, slots=True)
class PosePacket:
    """A pose of the body in the world."""

    position_m: tuple[float, ...]  # x, y, z: east, north, up
    quaternion: tuple[float, ...]  # x, y, z, w, body to world; the body's x axis is forward, z up
    t_ns: int | None = None  # time of the pose on the sender's clock, of any epoch; None stands for its arrival


def pack_pose(position_m: Sequence[float], quaternion: Sequence[float], t_ns: int | None = None) -> bytes:
    """Write the datagram of a pose; parameters as the fields of `PosePacket`."""
    flags = 0 if t_ns is None else _HAS_TIME
    return _LAYOUT.pack(_MAGIC, _VERSION, flags, 0, t_ns or 0, *position_m, *quaternion)


def is_pose(payload: bytes) -> bool:
    """Return whether a datagram is a pose packet, at a tenth of the cost of `unpack_pose`."""
    is_whole = len(payload) == POSE_BYTES and payload.startswith(_HEAD)
    return is_whole and payload[5] <= _HAS_TIME and payload.startswith(b"\0\0", 6)


def unpack_pose(payload: bytes) -> PosePacket:
    """Read the datagram of a pose; its numbers are not checked.

    Raises PacketError if it is none.
    """
    if len(payload) != POSE_BYTES:
        raise PacketError("pose packet", f"found {len(payload)} bytes", f"{POSE_BYTES}")
    magic, version, flags, zero, t_ns, *numbers = _LAYOUT.unpack(payload)
    if (magic, version) != (_MAGIC, _VERSION):
        found = f"found {payload[:5].hex(' ')}"
        raise PacketError("pose packet", found, f"{_HEAD.hex(' ')} at its beginning")
    if flags & ~_HAS_TIME or zero:
        raise PacketError("pose packet", f"found {payload[5:8].hex(' ')} at byte 5", "00 or 01, 00 00")
    return PosePacket(tuple(numbers[:3]), tuple(numbers[3:]), t_ns if flags else None)

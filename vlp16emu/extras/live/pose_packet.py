"""The datagram of a pose of the carrier in a live run, as in `protocol/pose_packet.toml`."""

import struct
from collections.abc import Sequence
from typing import NamedTuple

from vlp16emu.errors import PacketError

_LAYOUT = struct.Struct("<4sBBHq7d")
_MAGIC = b"POSE"
_VERSION = 1
_HAS_TIME = 1
_HEAD = _MAGIC + bytes([_VERSION])
_BEGINNINGS = tuple(_HEAD + bytes([flags, 0, 0]) for flags in (0, _HAS_TIME))
POSE_BYTES = _LAYOUT.size


class PosePacket(NamedTuple):
    """A pose of the body in the world."""

    position_m: tuple[float, ...]  # x, y, z: east, north, up
    quaternion: tuple[float, ...]  # x, y, z, w, body to world; the body's x axis is forward, z up
    t_ns: int | None = None  # time of the pose on the sender's clock, of any epoch; None for its arrival


def pack_pose(position_m: Sequence[float], quaternion: Sequence[float], t_ns: int | None = None) -> bytes:
    """Return the datagram of a pose; parameters as the fields of `PosePacket`."""
    flags = 0 if t_ns is None else _HAS_TIME
    return _LAYOUT.pack(_MAGIC, _VERSION, flags, 0, t_ns or 0, *position_m, *quaternion)


def is_pose(payload: bytes) -> bool:
    """Return True if a datagram is a pose packet, at a tenth of the cost of `unpack_pose`."""
    return len(payload) == POSE_BYTES and payload[:8] in _BEGINNINGS


def unpack_pose(payload: bytes) -> PosePacket:
    """Read the datagram of a pose; its numbers are not checked.

    Raises PacketError if it is no pose packet.
    """
    if not is_pose(payload):
        found = f"found {len(payload)} bytes that begin with {payload[:8].hex(' ')}"
        raise PacketError(
            "pose packet", found, f"{POSE_BYTES} that begin with {_HEAD.hex(' ')}, 00 or 01, 00 00"
        )
    *_, flags, _, t_ns, x, y, z, qx, qy, qz, qw = _LAYOUT.unpack(payload)
    return PosePacket((x, y, z), (qx, qy, qz, qw), t_ns if flags else None)

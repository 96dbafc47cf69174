"""The frame of a sample of the inertial unit, the same by UDP and on a serial line.

>>> IMU_FRAME.itemsize, IMU_FRAME.isalignedstruct
(72, True)

The format is our own, because no sensor of Velodyne has one; `protocol/imu_frame.toml` describes it. The
offset of each field is a multiple of its size, so it is a plain struct in C, and numbers equal the ground
truth to the last bit.
"""

import zlib

import numpy as np

from vlp16emu.errors import PacketError
from vlp16emu.types import F8, I8
from vlp16emu.units import S_NS

IMU_FRAME = np.dtype(
    [
        ("magic", "S3"),
        ("version", "u1"),
        ("checksum", "<u4"),  # CRC-32 of all bytes after it, as in zlib and Ethernet
        ("sequence", "<u8"),  # number of the sample since the start of the scene
        ("t_ns", "<i8"),
        ("angular_rate_rad_s", "<f8", 3),
        ("specific_force_m_s2", "<f8", 3),
    ],
    align=True,
)
_MAGIC = b"IMU"
_VERSION = 1
_CHECKED_FROM = 8  # offset of the bytes that the checksum covers


def imu_frames(first: int, t_ns: I8, rate_rad_s: F8, force_m_s2: F8) -> list[bytes]:
    """Return the frames of n consecutive samples.

    Parameters
    ----------
    first : number of the first sample
    t_ns : (n,) UTC
    rate_rad_s, force_m_s2 : (n, 3) in the unit's own axes
    """
    frames = np.zeros(len(t_ns), IMU_FRAME)
    frames["sequence"] = np.arange(first, first + len(t_ns))
    frames["t_ns"] = t_ns
    frames["angular_rate_rad_s"] = rate_rad_s
    frames["specific_force_m_s2"] = force_m_s2
    return [_with_checksum(frame) for frame in frames]


def decode_imu(frame: bytes) -> np.void:
    """Read a frame, and return its fields as an `IMU_FRAME`.

    Raises PacketError if length, magic, version or checksum is wrong.
    """
    if len(frame) != IMU_FRAME.itemsize:
        raise PacketError("IMU frame", f"found {len(frame)} bytes", f"{IMU_FRAME.itemsize}")
    fields: np.void = np.frombuffer(frame, IMU_FRAME)[0]
    if (fields["magic"], fields["version"]) != (_MAGIC, _VERSION):
        raise PacketError("IMU frame", f"begins with {frame[:4]!r}", f"{_MAGIC + bytes([_VERSION])!r}")
    if fields["checksum"] != (crc := zlib.crc32(frame[_CHECKED_FROM:])):
        raise PacketError("IMU frame", f"has the checksum {fields['checksum']:08x}", f"{crc:08x}")
    return fields


def shift_imu_frame(frame: bytes, by_s: int) -> bytes:
    """Return a frame with its time moved by whole seconds."""
    fields = np.frombuffer(frame, IMU_FRAME).copy()
    fields["t_ns"] += by_s * S_NS
    return _with_checksum(fields[0])


def _with_checksum(fields: np.void) -> bytes:
    """Return the frame of some fields, with magic, version and checksum."""
    checked_bytes = fields.tobytes()[_CHECKED_FROM:]
    return _MAGIC + bytes([_VERSION]) + zlib.crc32(checked_bytes).to_bytes(4, "little") + checked_bytes

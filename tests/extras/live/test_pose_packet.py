"""The datagram of a pose: golden bytes in both directions, its table, and what is refused."""

import struct
import tomllib
from pathlib import Path

import pytest

from vlp16emu.errors import PacketError
from vlp16emu.extras.live.pose_packet import POSE_BYTES, PosePacket, pack_pose, unpack_pose

PROTOCOL = Path(__file__).resolve().parents[3] / "protocol"
NAMES = ["pose", "pose_untimed"]
CODES = {"S4": "<4s", "u1": "<B", "u2": "<H", "i8": "<q", "f8": "<d"}


def golden(name):
    wire = tomllib.loads((PROTOCOL / "golden" / f"{name}.toml").read_text())["wire"]
    fields = wire["position_m"], wire["quaternion_xyzw"], wire.get("time_ns")
    return bytes.fromhex((PROTOCOL / "golden" / f"{name}.hex").read_text()), fields


@pytest.mark.parametrize("name", NAMES)
def test_golden_poses_in_both_directions(name):
    """A pose becomes the golden bytes of another writer, and these are read back as the pose."""
    payload, (position_m, quaternion, t_ns) = golden(name)
    assert pack_pose(position_m, quaternion, t_ns) == payload
    assert unpack_pose(payload) == PosePacket(tuple(position_m), tuple(quaternion), t_ns)


@pytest.mark.parametrize("name", NAMES)
def test_the_table_reads_golden_poses(name):
    """Read by the byte table alone, a golden pose holds what its meaning says, and the table has every
    byte."""
    payload, (position_m, quaternion, t_ns) = golden(name)
    table = tomllib.loads((PROTOCOL / "pose_packet.toml").read_text())
    read, end = {}, 0
    for row in table["payload"]:
        code = CODES[row["type"]]
        assert row["offset"] == end
        end += struct.calcsize(code)
        (read[row["name"]],) = struct.unpack_from(code, payload, row["offset"])
    assert end == table["size_bytes"] == POSE_BYTES == len(payload)
    head = read["magic"], read["version"], read["flags"], read["reserved"], read["time"]
    assert head == (b"POSE", 1, int(t_ns is not None), 0, t_ns or 0)
    assert [read[axis] for axis in ("x", "y", "z")] == position_m
    assert [read[part] for part in ("qx", "qy", "qz", "qw")] == quaternion


@pytest.mark.parametrize(
    ("at", "content", "message"),
    [
        (
            0,
            b"p",
            (
                "pose packet: found 72 bytes that begin with 70 4f 53 45 01 01 00 00; expected 72 that begin "
                "with 50 4f"
            ),
        ),
        (4, b"\x02", "50 4f 53 45 02 01 00 00; expected 72 that begin with 50 4f 53 45 01, 00 or 01, 00 00"),
        (5, b"\x02", "50 4f 53 45 01 02 00 00"),
        (7, b"\x01", "50 4f 53 45 01 01 00 01"),
        (0, b"", "found 71 bytes"),
        (0, b"PP", "found 73 bytes"),
    ],
)
def test_what_is_no_pose_packet_is_refused(at, content, message):
    """Another magic, version, flag or length, and reserved bytes that are not zero, are named in one line."""
    payload, _ = golden("pose")
    with pytest.raises(PacketError, match=message):
        unpack_pose(payload[:at] + content + payload[at + 1 :])

"""Frames of inertial samples."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from vlp16emu.errors import PacketError
from vlp16emu.extras.bench.imu_frame import IMU_FRAME, decode_imu, imu_frames
from vlp16emu.extras.bench.retime import age_ns, shift_packet, stamp_ns
from vlp16emu.types import Packet, PacketKind

GOLDEN = Path(__file__).resolve().parents[3] / "protocol" / "golden"
MEANING = tomllib.loads((GOLDEN / "imu.toml").read_text())
FRAME = bytes.fromhex((GOLDEN / "imu.hex").read_text())


def test_a_sample_becomes_the_golden_frame():
    """The sample that the golden meaning states becomes its bytes, and they are read back as it."""
    numbers = [np.array([MEANING[key]]) for key in ("t_ns", "angular_rate_rad_s", "specific_force_m_s2")]
    assert imu_frames(MEANING["sequence"], *numbers) == [FRAME]
    fields = decode_imu(FRAME)
    for key in ("sequence", "t_ns", "angular_rate_rad_s", "specific_force_m_s2"):
        assert fields[key].tolist() == MEANING[key]


def test_any_wrong_bit_is_found():
    """A frame with one bit turned over is refused, wherever it is; so is one of another length."""
    for bit in range(8 * len(FRAME)):
        wrong = bytearray(FRAME)
        wrong[bit // 8] ^= 1 << bit % 8
        with pytest.raises(PacketError, match="IMU frame"):
            decode_imu(bytes(wrong))
    with pytest.raises(PacketError, match="found 71 bytes; expected 72"):
        decode_imu(FRAME[:-1])


def test_moving_changes_time_and_checksum_alone():
    """By whole seconds, there and back to the same bytes; the stamp of the packet is that of UTC."""
    packet = Packet(PacketKind.IMU, MEANING["t_ns"], FRAME)
    later = shift_packet(packet, 16_133_300)
    fields = decode_imu(later.payload)
    assert fields["t_ns"] == MEANING["t_ns"] + 16_133_300 * 10**9
    assert later.payload[24:] == FRAME[24:]
    assert shift_packet(later, -16_133_300) == packet
    assert (stamp_ns(packet), age_ns(packet)) == (500_000_000, 0)
    assert IMU_FRAME.fields["t_ns"][1] == 16

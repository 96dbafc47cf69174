"""The lint against real sensors."""

from pathlib import Path

import pytest

from vlp16emu.extras.verify.frames import Rule
from vlp16emu.extras.verify.run import verify
from vlp16emu.sinks import PcapSink
from vlp16emu.types import Packet, PacketKind

CAPTURES = Path(__file__).parents[3] / ".." / "shared" / "captures"

pytestmark = pytest.mark.skipif(not CAPTURES.is_dir(), reason="no real captures beside the repository")


def test_real_capture_breaks_no_rule():
    """Data and position packets of a real unit, with the headers it sent, are accepted without a finding."""
    result = verify(CAPTURES / "mrpt_vlp16_gps.pcap")
    assert (result.findings, result.is_clean) == ((), True)
    assert (result.data_packets, result.position_packets, result.other_frames) == (293, 57, 0)
    assert result.rpm == pytest.approx(599.06, abs=0.05)  # as measured revolution by revolution


def test_real_dual_payloads_break_no_rule(tmp_path):
    """603 dual payloads of another unit, put into frames at the times they arrived, are accepted too."""
    payloads = (CAPTURES / "nebula_vlp16_dual.bin").read_bytes()
    stamps = (CAPTURES / "nebula_vlp16_dual.stamps_ns.txt").read_text().split()
    with PcapSink(tmp_path / "dual.pcap") as sink:
        for i, stamp_ns in enumerate(stamps):
            sink.send(Packet(PacketKind.DATA, int(stamp_ns), payloads[1206 * i : 1206 * (i + 1)]))
    result = verify(tmp_path / "dual.pcap")
    assert (result.findings, result.data_packets) == ((), 603)
    assert result.rpm == pytest.approx(599.97, abs=0.05)


def test_a_unit_before_release_breaks_no_rule():
    """Product byte and VeloView's headers of 2014 are notes; there is no error."""
    result = verify(CAPTURES / "rust_lidar_vlp16_2014.pcap")
    assert (result.counts, set(result.notes)) == ({}, {Rule.FACTORY, Rule.HEADER})

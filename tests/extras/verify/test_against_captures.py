"""The lint against real sensors."""

from pathlib import Path

import pytest

from vlp16emu.extras.verify.frames import Rule
from vlp16emu.extras.verify.run import verify
from vlp16emu.sinks import PcapSink
from vlp16emu.types import Packet, PacketKind, SensorModel

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


def framed(name, path):
    """Write payloads of a test bag into frames at the times they arrived."""
    payloads = (CAPTURES / f"{name}.bin").read_bytes()
    stamps = (CAPTURES / f"{name}.stamps_ns.txt").read_text().split()
    with PcapSink(path) as sink:
        for i, stamp_ns in enumerate(stamps):
            sink.send(Packet(PacketKind.DATA, int(stamp_ns), payloads[1206 * i : 1206 * (i + 1)]))
    return path


def test_a_real_hdl_32e_breaks_no_rule():
    """Its frames differ from a VLP-16's, which is no finding; its laser 11 sees nothing."""
    result = verify(CAPTURES / "mrpt_hdl32e.pcap")
    assert (result.model, result.counts, dict(result.notes)) == (SensorModel.HDL_32E, {Rule.LASER: 1}, {})
    assert result.findings[0].found == "laser 11 without returns"
    assert result.rpm == pytest.approx(542.3, abs=0.1)


def test_a_real_vlp_32c_breaks_no_rule(tmp_path):
    """It leaves out parts of four revolutions, which is a note; some packets arrived late in its bag."""
    result = verify(framed("nebula_vlp32c", tmp_path / "made.pcap"))
    assert (result.model, set(result.counts)) == (SensorModel.VLP_32C, {Rule.LATENESS})
    assert dict(result.notes) == {Rule.AZIMUTH_GAP: 4}
    assert result.rpm == pytest.approx(600.05, abs=0.05)


def test_a_real_vls_128_breaks_no_rule(tmp_path):
    """Its firing sequences are longer than in the manual, which is no finding; its laser 82 sees nothing."""
    result = verify(framed("nebula_vls128", tmp_path / "made.pcap"))
    assert (result.model, result.counts, dict(result.notes)) == (SensorModel.VLS_128, {Rule.LASER: 1}, {})
    assert result.findings[0].found == "laser 82 without returns"
    assert result.rpm == pytest.approx(599.9, abs=0.05)

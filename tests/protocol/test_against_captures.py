"""The byte tables against recordings of real sensors."""

import dpkt
import pytest

DATA_FRAMES, POSITION_FRAMES = 293, 57
DUAL_PACKETS = 603


@pytest.fixture(scope="module")
def frames(capture):
    with capture("mrpt_vlp16_gps.pcap").open("rb") as file:
        return [frame for _, frame in dpkt.pcap.Reader(file)]


@pytest.mark.parametrize(("table", "count"), [("data_packet", DATA_FRAMES), ("position_packet", POSITION_FRAMES)])
def test_headers(request, frames, table, count):
    """Every frame of a real sensor carries the header bytes that the table calls fixed."""
    frame = request.getfixturevalue(table)["frame"]
    same_size = [real for real in frames if len(real) == frame["size_bytes"]]
    assert len(same_size) == count
    for row in frame["header"]:
        if row["fixed"]:
            stated = bytes.fromhex(row["bytes"])
            assert {real[row["offset"] : row["offset"] + len(stated)] for real in same_size} == {stated}, row


def test_position_packets_are_zero_where_stated(position_packet, frames):
    """In a real sensor of 2016 the bytes marked zero are zero, and no others."""
    payloads = [frame[42:] for frame in frames if len(frame) == position_packet["frame"]["size_bytes"]]
    zero = {row["name"] for row in position_packet["payload"] if row.get("before_2018") == 0}
    starts = [row["offset"] for row in position_packet["payload"]]
    ends = [*starts[1:], position_packet["size_bytes"]]
    silent = {
        row["name"]
        for row, start, end in zip(position_packet["payload"], starts, ends, strict=True)
        if not any(any(payload[start:end]) for payload in payloads)
    }
    assert silent == zero


def test_codes_stay_in_their_bounds(oracle, frames):
    """A real sensor keeps flag, azimuth, time stamp and distance codes within what the table says."""
    payloads = [frame[42:] for frame in frames if len(frame) == oracle.data["frame"]["size_bytes"]]
    least = oracle.row("record", "distance")["minimum"]
    for payload in payloads[::10]:
        assert 0 <= oracle.field("payload", "timestamp", payload) <= oracle.row("payload", "timestamp")["maximum"]
        for block in oracle.array("payload", "blocks"):
            assert oracle.field("block", "flag", payload, block) == oracle.row("block", "flag")["values"]["block"]
            assert oracle.field("block", "azimuth", payload, block) <= oracle.row("block", "azimuth")["maximum"]
        codes = [record["distance_code"] for record in oracle.records(payload)]
        assert all(code == 0 or code >= least for code in codes)
        assert any(codes)

"""Decoding against a slow twin, and by its rules."""

import itertools
import math

import numpy as np
import pytest
from packets.kit import make_returns, random_returns

from vlp16emu.errors import PacketError
from vlp16emu.packets import (
    data_fields,
    data_payloads,
    decode_data,
    decode_position,
    pack_position,
    scan_starts,
)
from vlp16emu.packets.layout import DATA_PAYLOAD
from vlp16emu.sensor.beams import BEAM_TABLES
from vlp16emu.types import PpsState, ReturnMode, SensorModel

VLP_16 = SensorModel.VLP_16


def steady(mode, packets, start_deg=358.0, step_deg=0.1990656, clock_ns=0):
    """Payloads of a rotor without errors, every distance 10 m."""
    sequences = packets * (12 if mode is ReturnMode.DUAL else 24)
    returns = make_returns(
        sequences,
        clock_ns=clock_ns,
        reading_deg=(start_deg + np.arange(sequences) * step_deg) % 360,
        distance_m=np.full((sequences, 16, 3), 10, np.float32),
    )
    return data_payloads(returns, mode, VLP_16).copy()


def slow_points(payloads, model):
    """Decode the obvious way: tuples of packet, laser, azimuth in degrees, x, y, z in metres, pulse by
    pulse."""
    packets = payloads.view(DATA_PAYLOAD)[:, 0]
    stride = 2 if packets["return_mode"][0] == 0x39 else 1
    for p, b in itertools.product(range(len(packets)), range(0, 12, stride)):
        azimuths = [int(azimuth) for azimuth in packets[p]["blocks"]["azimuth_cdeg"][::stride]]
        step = ((azimuths[-1] - azimuths[0]) % 36000) / (len(azimuths) - 1)
        for r in range(32):
            j = r % 16
            azimuth_deg = (
                (azimuths[b // stride] + step * (r // 16 * 55.296 + j * 2.304) / 110.592) / 100 % 360
            )
            a, w = math.radians(azimuth_deg), math.radians(BEAM_TABLES[model].elevation_deg[j])
            for twin in range(stride):
                distance = packets[p]["blocks"][b + twin]["records"][r]["distance_lsb"] * 0.002
                x = distance * math.cos(w) * math.cos(a)
                y = -distance * math.cos(w) * math.sin(a)
                z = distance * math.sin(w) + BEAM_TABLES[model].vertical_offset_m[j]
                yield p, j, azimuth_deg, x, y, z


@pytest.mark.parametrize("mode", ReturnMode)
@pytest.mark.parametrize("model", [SensorModel.VLP_16, SensorModel.PUCK_HI_RES])
def test_against_slow_twin(mode, model):
    """Azimuths and coordinates are those of a loop over the manual's formulas, with its y as x and its -x
    as y."""
    payloads = data_payloads(random_returns(24 * 4, seed=21), mode, model)
    points = decode_data(payloads, keep_no_returns=True)
    packet, laser, azimuth_deg, *xyz_m = np.array(list(slow_points(payloads, model))).T
    np.testing.assert_array_equal(points.packet, packet)
    np.testing.assert_array_equal(points.laser, laser)
    np.testing.assert_allclose(points.azimuth_deg, azimuth_deg, atol=1e-9)
    seen = points.distance_m > 0
    np.testing.assert_allclose(points.xyz_m[seen], np.stack(xyz_m, axis=1)[seen], atol=2e-5)
    assert np.isnan(points.xyz_m[~seen]).all()


@pytest.mark.parametrize("mode", ReturnMode)
def test_dropping_no_returns(mode):
    """Without the pulses that found nothing the other records are the same, in the same order; no packets
    give no points."""
    assert len(decode_data(np.zeros((0, 1206), np.uint8), keep_no_returns=True).laser) == 0
    payloads = data_payloads(random_returns(24 * 3, seed=22), mode, VLP_16)
    every, some = (decode_data(payloads, keep_no_returns=keep) for keep in (True, False))
    seen = every.distance_m > 0
    assert 0 < seen.sum() < len(seen)
    for name in every.__slots__:
        np.testing.assert_array_equal(getattr(some, name), getattr(every, name)[seen])


def test_blind_sector_does_not_smear():
    """A jump from one edge of the field of view to the other turns no pulse by more than a block's step."""
    payloads = steady(ReturnMode.STRONGEST, 1, start_deg=85)
    blocks = payloads.view(DATA_PAYLOAD)["blocks"][:, 0]
    blocks["azimuth_cdeg"][0, 6:] += 18_000
    points = decode_data(payloads, keep_no_returns=True)
    turned_deg = points.azimuth_deg.reshape(12, 32) - blocks["azimuth_cdeg"][0][:, None] / 100
    assert turned_deg.max() < 0.4
    assert turned_deg.min() >= 0


def test_mode_may_change():
    """Packets before and after a change of return mode are decoded as alone."""
    single = steady(ReturnMode.STRONGEST, 2)
    dual = steady(ReturnMode.DUAL, 2, start_deg=20)
    both = decode_data(np.concatenate([single, dual]), keep_no_returns=True)
    for rows, alone in ((slice(0, 768), single), (slice(768, None), dual)):
        np.testing.assert_array_equal(both.xyz_m[rows], decode_data(alone, keep_no_returns=True).xyz_m)


@pytest.mark.parametrize(
    ("offset", "value", "message"),
    [
        (300, 0xFE, "data packet 1: block flag: 0xeefe; expected 0xeeff"),
        (1204, 0x36, "data packet 1: return mode: 0x36; expected 0x37, 0x38 or 0x39"),
        (1205, 0x23, "data packet 1: product: 0x23; expected 0x21, 0x22, 0x24, 0x28 or 0xa1"),
        (1205, 0x24, "data packet 1: product: 0x24; expected 0x22 as of the others"),
        (103, 0xFF, "data packet 1: azimuth: 0xfff1; expected 0 to 36000 hundredths of a degree"),
    ],
)
def test_refuses_other_packets(offset, value, message):
    """Bytes that a VLP-16 does not send are an error that names the packet and what stands there."""
    payloads = steady(ReturnMode.STRONGEST, 3)
    payloads.view(DATA_PAYLOAD)["blocks"]["azimuth_cdeg"] = 0xF1
    payloads[1:, offset] = value
    with pytest.raises(PacketError) as error:
        decode_data(payloads, keep_no_returns=False)
    assert str(error.value) == message


def test_the_first_packet_at_fault_is_named():
    """Of a late packet with a broken flag and an earlier one of an unknown mode, the earlier is reported."""
    payloads = steady(ReturnMode.STRONGEST, 4)
    payloads[3, 300] = 0xFE
    payloads[2, 1204] = 0x36
    with pytest.raises(PacketError, match="data packet 2: return mode: 0x36"):
        decode_data(payloads, keep_no_returns=False)


@pytest.mark.parametrize("shape", [(1206,), (2, 1200), (2, 1248)])
def test_refuses_other_lengths(shape):
    """Payloads of another length are an error before anything is read from them."""
    with pytest.raises(PacketError, match=r"expected \(n, 1206\) uint8"):
        data_fields(np.zeros(shape, np.uint8))


@pytest.mark.parametrize(
    ("azimuth_deg", "starts"),
    [
        ([], []),
        ([5.0], [0]),
        ([10, 200, 359, 1, 2], [0, 3]),
        ([300, 140, 300], [0, 1]),  # nothing seen over more than half a turn
        ([10, 9.99, 10.4, 10.39], [0]),  # noise of readings
        ([359.9, 0.0, 359.99, 0.4, 100], [0, 1]),  # the same where it wraps
        ([359.9, 0.1, 359.9, 0.1], [0, 1]),
        ([350, 10, 350, 10], [0, 1, 3]),
    ],
)
def test_scan_starts_by_hand(azimuth_deg, starts):
    """Falls of the azimuth begin scans, noise around any angle does not."""
    assert scan_starts(np.array(azimuth_deg, np.float64)).tolist() == starts


@pytest.mark.parametrize(
    ("payload", "message"),
    [
        (bytes(511), "position packet: 511 bytes; expected 512"),
        (bytes(202) + b"\x04" + bytes(309), "position packet: PPS state: 4; expected 0 to 3"),
    ],
)
def test_refuses_other_position_packets(payload, message):
    """A wrong length or an unknown state is an error that shows it."""
    with pytest.raises(PacketError) as error:
        decode_position(payload)
    assert str(error.value) == message


def test_sentence_ends_at_nul():
    """What stands behind the first NUL is no part of the sentence."""
    payload = bytearray(pack_position(0, PpsState.LOCKED, b"$A\r\n"))
    payload[215] = ord("x")
    assert decode_position(bytes(payload)).sentence == b"$A\r\n"

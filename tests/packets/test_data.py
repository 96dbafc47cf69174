"""Packing of data packets, byte by byte against a slow twin and by its rules."""

import doctest
import struct

import numpy as np
import pytest
from packets.kit import make_returns, random_returns

from vlp16emu.errors import InputError
from vlp16emu.packets import data_payloads, layout, pack_data, timestamp_us
from vlp16emu.packets.layout import DATA_PAYLOAD
from vlp16emu.types import PacketKind, ReturnMode, SensorModel

HOUR_NS = 3_600 * 10**9
VLP_16 = SensorModel.VLP_16


def record(returns, s, j, which):
    """One record as the slow twin writes it."""
    code = round(float(returns.distance_m[s, j, which]) * 500)
    return struct.pack("<HB", code if 250 <= code <= 65535 else 0, returns.reflectivity[s, j, which])


def slow_payloads(returns, mode):
    """Pack the obvious way, one record after the other."""
    dual = mode is ReturnMode.DUAL
    out = b""
    for first in range(0, len(returns.distance_m), 12 if dual else 24):
        for s in range(first, first + (12 if dual else 24), 2):
            azimuth = int(float(returns.firings.reading_deg[s]) * 100) % 36000
            for odd in (False, True) if dual else (None,):
                out += b"\xff\xee" + struct.pack("<H", azimuth)
                for sequence in (s, s + 1):
                    for j in range(16):
                        strongest, last, second = returns.distance_m[sequence, j]
                        if odd is None:
                            which = 1 if mode is ReturnMode.LAST else 0
                        elif not odd:
                            which = 1
                        else:
                            has_second = second > 0 or returns.reflectivity[sequence, j, 2] > 0
                            which = 2 if strongest == last and has_second else 0
                        out += record(returns, sequence, j, which)
        clock_us = int(returns.firings.clock_ns[first]) // 1000
        out += struct.pack("<IBB", clock_us, {"strongest": 0x37, "last": 0x38, "dual": 0x39}[mode], 0x22)
    return np.frombuffer(out, np.uint8).reshape(-1, 1206)


@pytest.mark.parametrize("mode", ReturnMode)
def test_against_slow_twin(mode):
    """The vectorised packer writes what a loop over single records writes, each packet by itself."""
    returns = random_returns(24 * 5, seed=11)
    np.testing.assert_array_equal(data_payloads(returns, mode, VLP_16), slow_payloads(returns, mode))


@pytest.mark.parametrize(("mode", "sequences"), [("strongest", 24), ("last", 24), ("dual", 12)])
def test_due_after_the_last_sequence(mode, sequences):
    """A packet leaves 24 firing sequences (12 in dual return) after its first pulse."""
    start_ns = 1_779_267_600_000_000_123
    packets = pack_data(make_returns(48, t_ns=start_ns), ReturnMode(mode), VLP_16)
    due_ns = [start_ns + (p + 1) * sequences * 55_296 for p in range(48 // sequences)]
    assert [packet.due_ns for packet in packets] == due_ns
    assert {packet.kind for packet in packets} == {PacketKind.DATA}
    assert {len(packet.payload) for packet in packets} == {1206}


def test_time_is_floored_to_microseconds():
    """Time stamps are whole microseconds, rounded down, and begin anew each hour."""
    clock_ns = np.array([0, 999, 1_000, 999_999_999, HOUR_NS - 1, HOUR_NS, -350_000])
    assert timestamp_us(clock_ns).tolist() == [0, 0, 1, 999_999, 3_599_999_999, 0, 3_599_999_650]


def azimuth_codes(reading_deg):
    """Codes of one angle per block."""
    readings = np.repeat(np.resize(reading_deg, -(-len(reading_deg) // 12) * 12), 2)
    payloads = data_payloads(make_returns(len(readings), reading_deg=readings), ReturnMode.STRONGEST, VLP_16)
    return payloads.view(DATA_PAYLOAD)["blocks"]["azimuth_cdeg"].ravel()[: len(reading_deg)]


def test_every_azimuth_code():
    """Each of the 36000 whole hundredths of a degree becomes its code, between two the lower is sent,
    never 36000; nothing gives no packets."""
    np.testing.assert_array_equal(azimuth_codes(np.arange(36000) / 100), np.arange(36000))
    codes = azimuth_codes(np.array([0.0099, 123.4567, 359.9999, 359.9999999999, np.nextafter(360, 0)]))
    assert codes.tolist() == [0, 12345, 35999, 0, 0]
    assert pack_data(make_returns(0), ReturnMode.STRONGEST, VLP_16) == []


def test_distance_codes():
    """Distances are rounded to 2 mm; less than 0.5 m or more than 16 bits is no return; reflectivity
    stays."""
    sent_m = np.array(
        [0, 0.002, 0.498, 0.5, 0.501, 0.5011, 1.2345, 99.9989, 131.07, 131.072, 500], np.float32
    )
    codes = [0, 0, 0, 250, 250, 251, 617, 49999, 65535, 0, 0]
    distance_m = np.zeros((24, 16, 3), np.float32)
    distance_m[0, : len(codes)] = sent_m[:, None]
    returns = make_returns(24, distance_m=distance_m, reflectivity=np.full((24, 16, 3), 77, np.uint8))
    records = data_payloads(returns, ReturnMode.STRONGEST, VLP_16).view(DATA_PAYLOAD)["blocks"]["records"]
    assert records["distance_lsb"].reshape(24, 16)[0, : len(codes)].tolist() == codes
    assert set(records["reflectivity"].ravel()) == {77}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"reading_deg": np.full(24, np.nan)}, ("firings.reading_deg: from nan to nan; expected finite "
                                               "numbers from 0 upwards")),
        ({"distance_m": np.full((24, 16, 3), -1, np.float32)}, ("distance_m: from -1.0 to 0.0; expected "
                                                               "finite numbers from 0 upwards")),
        ({"distance_m": np.full((24, 16, 3), np.inf, np.float32)}, ("distance_m: from 0.0 to inf; "
                                                                   "expected finite numbers from 0 upwards")),
    ],
)  # fmt: skip
def test_refuses_what_cannot_be_packed(changes, message):
    """Angles and distances that no sensor measures are named, and not sent."""
    with pytest.raises(InputError) as error:
        pack_data(make_returns(**{"sequences": 24, **changes}), ReturnMode.STRONGEST, VLP_16)
    assert str(error.value) == f"pack_data: {message}"


def test_doctest():
    """The sizes of both packets that the docstring of the layout shows are true."""
    assert doctest.testmod(layout) == (0, 3)

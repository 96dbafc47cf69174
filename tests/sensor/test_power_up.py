"""The state in which a run finds a unit: time since power-up, rotor, clock, counters and MAC address."""

import numpy as np
import pytest
from scipy import stats

from vlp16emu.engine import Engine
from vlp16emu.scenario import load
from vlp16emu.sensor.power_up import counters_of, with_start_state
from vlp16emu.sensor.settings import Sensor
from vlp16emu.types import PacketKind

HALL = {
    "schema": 1,
    "motion": {"kind": "static"},
    "world": {"kind": "hall", "length_m": 9.0, "width_m": 7.0, "height_m": 3.0},
}


def test_units_differ_in_their_state():
    """Over many seeds rotors stand anywhere (KS), clocks are within 2 ppm of nominal or up to 20 off, and
    no MAC address comes twice."""
    units = [with_start_state(Sensor(), seed) for seed in range(400)]
    assert stats.kstest([unit.start_azimuth_deg / 360 for unit in units], "uniform").pvalue > 0.01
    assert min(unit.powered_for_s for unit in units) >= 60
    ppm = np.array([unit.clock_error_ppm for unit in units])
    assert 0.75 < (np.abs(ppm) < 2.5).mean() < 0.95
    assert 10 < ppm.max() <= 20
    macs = {counters_of(Sensor(), seed, 0).mac for seed in range(400)}
    assert len(macs) > 395
    assert {mac[:3] for mac in macs} == {bytes.fromhex("607688")}


def test_what_is_set_is_kept_and_a_steady_unit_begins_with_the_run():
    """Keys of the scene hold, one by one; `steady` has round numbers, and counts from 0."""
    assert with_start_state(Sensor(start_azimuth_deg=5.0), 7).start_azimuth_deg == 5.0
    steady = with_start_state(Sensor(preset="steady"), 7)
    assert (steady.start_azimuth_deg, steady.powered_for_s, steady.clock_error_ppm) == (0.1, 0.0, 0.0)
    assert counters_of(steady, 7, 1).mac == bytes.fromhex("607688380002")
    assert counters_of(steady, 7, 1).identification == 0


@pytest.mark.parametrize("connected", [True, False])
def test_stamps_are_on_no_lattice_of_whole_seconds(connected):
    """The first stamp is no whole second, and no number of packet periods past one, with GPS or without
    (real units: none)."""
    for seed in range(1, 6):
        engine = Engine.of(load({**HALL, "seed": seed, "gps": {"connected": connected}}))
        unit = engine.parts.units[0]
        stamps_us = unit.head.clock.reading_ns(unit.head.times_ns(0, 240)[::24, 0]) // 1000
        before_us = (stamps_us[:, None] - 300_000_000 * np.arange(12)) % 3_600_000_000
        on_lattice = np.floor(np.ceil(before_us / 1327.104 - 1e-9) * 1327.104 + 1e-6) == before_us
        assert not on_lattice.all(axis=0).any()
        assert engine.scenario.start_ns % 10**9


def test_a_start_with_a_fraction_of_a_second_is_kept():
    """An instant that is given to the microsecond is that of the first pulse; with `steady` a whole second
    is too."""
    assert load(HALL, ["start_utc=2026-05-20T09:00:00.25Z"]).start_ns % 10**9 == 250_000_000
    assert load(HALL, ["sensor.preset=steady"]).start_ns % 10**9 == 0


def test_position_packets_begin_anywhere_in_their_pattern():
    """The first one comes within 11 ms, its number and its identification are the unit's own, and both
    count on."""
    firsts = []
    for seed in range(1, 9):
        engine = Engine.of(load({**HALL, "seed": seed}))
        sent = [p for p in engine.packets(0.0, 0.03) if p.kind is PacketKind.POSITION]
        assert 0 <= sent[0].due_ns - engine.scenario.start_ns < 11_000_000
        assert [p.number - sent[0].number for p in sent] == list(range(len(sent)))
        firsts.append(engine.parts.units[0].link.identification)
    assert len(set(firsts)) == 8

"""Events of a run: what is set on sensors while they run, and what goes wrong, found in the bytes."""

import numpy as np
import pytest
from kit import data_payloads

from vlp16emu import Emulator
from vlp16emu.engine import Job, scan
from vlp16emu.engine.field_of_view import FieldOfView
from vlp16emu.engine.timeline import Packer
from vlp16emu.packets import data_fields, decode_position, points_in
from vlp16emu.scenario import load
from vlp16emu.sensor.head import Head
from vlp16emu.types import PacketKind
from vlp16emu.units import S_NS, US_NS

pytestmark = pytest.mark.usefixtures("kept_woods")

BLOCK_US = 110.592


def emulator(*events, scene="static_bench", threads=2, window_s=5.0, gps=True, **sensor):
    """A sensor on a tripod in a hall, by default one without errors whose pulses are one ray each."""
    settings = {"gps.connected": gps, "gps.pps_window_s": window_s, "events": list(events)}
    settings |= {f"sensor.{key}": value for key, value in sensor.items()}
    return Emulator(scene, settings, threads=threads)


def load_unit(*events, **settings):
    """The first unit of a hall with events."""
    scene = {"gps.connected": True, "events": list(events), **settings}
    return Emulator("static_bench", scene).parts.units[0]


def data_of(packets, scene="static_bench"):
    """Payloads of data packets (n, 1206), and when they leave, s since the first pulse."""
    data = [packet for packet in packets if packet.kind is PacketKind.DATA]
    due_ns = np.array([packet.due_ns for packet in data]) - load(scene).start_ns
    return np.frombuffer(b"".join(packet.payload for packet in data), np.uint8).reshape(-1, 1206), due_ns


def blocks_of(payloads):
    """Azimuths (n, 12) in hundredths of a degree, and distances (n, 12, 2, 16) in 2 mm."""
    blocks = data_fields(payloads)["blocks"]
    return blocks["azimuth_cdeg"].astype(int), blocks["records"]["distance_lsb"]


def stamps_us(payloads):
    return data_fields(payloads)["timestamp_us"].astype(float)


def setting(at_s, **keys):
    return {"kind": "setting", "at_s": at_s, **keys}


def speeds_rpm(payloads):
    """Speed within each packet of single return, from its first azimuth to its last."""
    azimuth, _ = blocks_of(payloads)
    return ((azimuth[:, 11] - azimuth[:, 0]) % 36000) / 100.0 / (11 * BLOCK_US * 1e-6) / 6.0


def test_packets_of_a_field_of_view_stay_the_same_where_others_are_left_out():
    """A live run that was too slow for some blocks goes on with packets of the run without gaps, and most
    of them."""
    run = emulator(setting(0.0, fov_deg=[90, 214]))
    unit, block, geometry = (
        run.parts.units[0],
        run.engine.batching.block,
        run.engine.windows.at_block(0).result(),
    )
    (stretch,) = unit.timeline.stretches(0, S_NS)
    scanned = [
        scan(Job(unit, unit.detector, range(number, number + 1), block, run.parts.world.seed), geometry)
        for number in stretch.blocks(block)[:180]
    ]

    def payloads(returns):
        packer = Packer(unit, stretch)
        return [packet.payload for some in returns for packet in packer.pack(some)]

    left_out = {5, 50, 51, 52, 53, 54, 120}
    whole, rest = payloads(scanned), payloads(one for n, one in enumerate(scanned) if n not in left_out)
    assert set(rest) < set(whole)
    assert len(whole) - 2 * len(left_out) * block // 24 < len(rest)


def test_another_speed_is_reached_by_a_ramp():
    """From 600 to 900 rpm the rotor runs up by 300 rpm per second, without a jump of its angle, and stays
    there."""
    payloads, due_ns = data_of(emulator(setting(0.4, rpm=900)).packets(0.0, 2.0))
    speed, at_s = speeds_rpm(payloads), due_ns / S_NS - 0.0007
    expected = 600.0 + 300.0 * np.clip(at_s - 0.4, 0.0, 1.0)
    assert abs(speed - expected).max() < 16  # noise of the encoder, and its eccentricity
    assert abs((speed - expected).mean()) < 0.5
    steps = np.diff(blocks_of(payloads)[0].reshape(-1)) % 36000
    assert 30 < steps.min() < steps.max() < 70


def test_return_modes_follow_each_other(each_unit):
    """Packets are single, then dual, then single return, each at its rate and in its own mode; no pulse is
    left out."""
    modes = setting(0.4, return_mode="dual"), setting(0.8, return_mode="last")
    payloads, due_ns = data_of(emulator(*modes, scene=each_unit).packets(0.0, 1.2), each_unit)
    for begin_s, mode, per_s in ((0.0, 0x37, 753.5), (0.4, 0x39, 1507.0), (0.8, 0x38, 753.5)):
        here = (due_ns > (begin_s + 0.0015) * S_NS) & (due_ns < (begin_s + 0.4) * S_NS)
        assert set(payloads[here, 1204]) == {mode}
        assert abs(here.sum() - 0.4 * per_s) < 3
    gaps = np.unique(np.diff(due_ns))
    assert set(gaps.tolist()) <= {1_327_104, 663_552}


def test_a_field_of_view_fills_packets_from_inside_it(each_unit):
    """Azimuths of 90 to 180 degrees alone are sent, in whole packets, a quarter as many, in order of time;
    from 350 to 9 the sector goes through 0."""
    quarter = emulator(setting(1.0, fov_deg=[90, 179]), scene=each_unit)
    payloads, due_ns = data_of(quarter.packets(1.0, 2.0), each_unit)
    azimuth, _ = blocks_of(payloads[due_ns > 1.002 * S_NS])
    assert azimuth.min() >= 9000
    assert azimuth.max() < 18000
    assert abs(len(azimuth) - 753.5 / 4) < 4
    assert ((np.diff(azimuth.reshape(-1)) > 0) | (np.diff(azimuth.reshape(-1)) < -8900)).all()
    through_0 = emulator(setting(0.0, fov_deg=[350, 9]), scene=each_unit)
    azimuth, _ = blocks_of(data_of(through_0.packets(0.0, 0.4))[0])
    assert ((azimuth >= 35000) | (azimuth < 1000)).all()
    assert (azimuth >= 35000).any()
    assert (azimuth < 1000).any()


def test_a_span_gives_the_packets_of_the_whole_run(each_unit):
    """Packets of events do not depend on the span that is asked for, nor on threads."""
    events = (
        setting(0.15, fov_deg=[20, 200]),
        setting(0.45, rpm=1200, return_mode="dual"),
        setting(0.75, fov_deg=[0, 359], return_mode="last"),
        {"kind": "power_cycle", "at_s": 1.0, "off_s": 0.2},
        {"kind": "dead_laser", "at_s": 0.1, "laser": 7, "duration_s": 0.5},
    )
    whole = list(emulator(*events, scene=each_unit).packets(0.0, 1.5))
    begin_ns = load(each_unit).start_ns
    for start_s, stop_s in ((0.0, 0.4), (0.25, 0.6), (0.55, 1.1), (1.15, 1.5)):
        span = [p for p in whole if begin_ns + start_s * S_NS <= p.due_ns < begin_ns + stop_s * S_NS]
        part = emulator(*events, scene=each_unit, threads=1)
        assert list(part.packets(start_s, stop_s)) == span


def test_a_power_cycle_is_silent_and_resets_the_clock(each_unit):
    """Nothing leaves while the power is off; then the clock counts from 0, unsaved settings are lost, and
    it locks after its window."""
    events = setting(0.5, rpm=1200), {"kind": "power_cycle", "at_s": 1.0, "off_s": 0.5}
    run = emulator(*events, scene=each_unit, window_s=1.0)
    packets = list(run.packets(0.0, 3.0))
    since_ns = np.array([packet.due_ns for packet in packets]) - run.scenario.start_ns
    assert not ((since_ns >= 1.0014 * S_NS) & (since_ns < 1.5 * S_NS)).any()
    assert all(decode_position(packet.payload) for packet in packets if packet.kind is PacketKind.POSITION)
    payloads, due_ns = data_of(packets, each_unit)
    stamp_us = stamps_us(payloads)
    first = int(np.searchsorted(due_ns, 1.5 * S_NS))
    assert stamp_us[first] < 2_000
    assert speeds_rpm(payloads[first : first + 50]).mean() == pytest.approx(600, abs=6)
    utc_us = (run.scenario.start_ns + due_ns - 1_327_104) // US_NS % 3_600_000_000
    assert abs(stamp_us[-1] - utc_us[-1]) <= 1
    jump = int(np.argmax(np.diff(stamp_us[first:]))) + first
    assert due_ns[jump] / S_NS == pytest.approx(2.5, abs=0.01)


def test_a_stopped_motor_sends_one_azimuth(each_unit):
    """The rotor runs down from 300 rpm to a halt within 1 s and up again afterwards, and is found where it
    halted."""
    stop = {"kind": "motor_stop", "at_s": 0.1, "duration_s": 1.3}
    payloads, due_ns = data_of(emulator(stop, scene=each_unit, rpm=300).packets(0.0, 2.8), each_unit)
    speed = speeds_rpm(payloads)
    halted = (due_ns > 1.15 * S_NS) & (due_ns < 1.35 * S_NS)
    azimuth, _ = blocks_of(payloads[halted])
    assert np.ptp(azimuth) <= 6
    assert speed[due_ns > 2.5 * S_NS].mean() == pytest.approx(300, abs=2)


def test_a_wobble_is_a_sine_of_the_speed():
    """The speed differs from the one set by a sine of the amplitude and period that are given, for as long
    as it lasts."""
    wobble = {"kind": "rpm_wobble", "at_s": 0.4, "duration_s": 1.0, "amplitude_rpm": 60.0, "period_s": 0.5}
    run = emulator(wobble, azimuth_noise_deg=0.0, eccentricity_deg=0.0)
    payloads, due_ns = data_of(run.packets(0.0, 1.8))
    at_s = due_ns / S_NS - 0.00072
    during = (at_s > 0.4) & (at_s < 1.4)
    expected = np.where(during, 600 + 60 * np.sin(2 * np.pi * (at_s - 0.4) / 0.5), 600.0)
    assert abs(speeds_rpm(payloads) - expected).max() < 3  # azimuths are in hundredths of a degree


def test_phase_is_pulled_in_and_held_through_a_change_of_speed():
    """At each UTC second the rotor is at the angle that is set, within 0.02 degrees, before and after
    another speed."""
    run = emulator(
        setting(0.2, phase_lock_deg=77.0), setting(3.5, rpm=900), azimuth_noise_deg=0.0, eccentricity_deg=0.0
    )
    rotor = run.parts.head.rotor
    for second in (2, 3, 6, 7):
        at_ns = second * S_NS - run.scenario.start_ns % S_NS
        assert rotor.angle_deg(np.array([at_ns]))[0] == pytest.approx(77.0, abs=0.02)
    angles = np.unwrap(rotor.angle_deg(np.arange(0, 7 * S_NS, 1_000_000)), period=360)
    assert 3.4 < np.diff(angles).min() < np.diff(angles).max() < 5.8  # degrees per millisecond: no jump


def test_a_dead_laser_has_no_returns(each_unit):
    """Its records are empty for as long as it is dead, and those of its neighbours are not."""
    dead = {"kind": "dead_laser", "at_s": 0.2, "laser": 3, "duration_s": 0.2}
    payloads, due_ns = data_of(emulator(dead, scene=each_unit).packets(0.0, 0.6), each_unit)
    _, distance = blocks_of(payloads)
    during = (due_ns > 0.203 * S_NS) & (due_ns < 0.4 * S_NS)
    assert not distance[during][..., 3].any()
    assert (distance[during][..., 4] > 0).mean() > 0.9
    assert (distance[~during][..., 3] > 0).mean() > 0.9


def test_a_dirty_window_takes_its_share_of_the_light_twice(each_unit):
    """Reflectivity in the sector is that of a clean window times the transmission squared; elsewhere it is
    the same."""
    dirty = {"kind": "dirty_window", "at_s": 0.0, "sector_deg": [40, 80], "transmission": 0.5}
    runs = [emulator(*events, scene=each_unit) for events in ([], [dirty])]
    (clean, _), (dimmed, _) = (data_of(run.packets(0.0, 0.5)) for run in runs)
    azimuth, _ = blocks_of(clean)
    light = [p[:, :1200].reshape(-1, 12, 100)[..., 6::3].astype(float) for p in (clean, dimmed)]
    inside = (azimuth > 4100) & (azimuth < 7900)
    assert (light[1][inside].sum() / light[0][inside].sum()) == pytest.approx(0.25, abs=0.03)
    outside = (azimuth < 3900) | (azimuth > 8100)
    assert (light[0][outside] == light[1][outside]).all()


def test_dirt_stands_in_the_way_of_beams_not_of_the_rotor():
    """All points of a VLS-128 in the sector are darker, and none beside it, though its beams are up to
    6.4 deg off the rotor's angle."""
    dirty = {"kind": "dirty_window", "at_s": 0.0, "sector_deg": [40, 80], "transmission": 0.5}
    clean, dimmed = (
        points_in(data_fields(data_payloads(Emulator("static_bench", settings).packets(0.0, 0.05))))
        for settings in ({"sensor.model": "vls-128"}, {"sensor.model": "vls-128", "events": [dirty]})
    )
    x_m, y_m, _ = clean.xyz_m.T
    azimuth_deg = np.degrees(np.arctan2(-y_m, x_m)) % 360
    is_darker = dimmed.reflectivity < clean.reflectivity
    assert is_darker[(azimuth_deg > 40.1) & (azimuth_deg < 79.9)].all()
    assert not is_darker[(azimuth_deg < 39.9) | (azimuth_deg > 80.1)].any()
    assert is_darker.sum() > 10_000


def test_a_free_clock_steps_and_drifts():
    """A step of 2 ms and a drift of 100 ppm are in the stamps of a sensor without GPS."""
    event = {"kind": "oscillator", "at_s": 0.5, "offset_us": 2000.0, "drift_ppm": 100.0}
    payloads, due_ns = data_of(emulator(event, gps=False).packets(0.0, 1.5))
    ahead_us = stamps_us(payloads) - (due_ns - 1_327_104) / US_NS
    at_s = (due_ns - 1_327_104) / S_NS
    expected = np.where(at_s >= 0.5, 2000.0 + 100.0 * (at_s - 0.5), 0.0)
    assert abs(ahead_us - expected).max() <= 1.5


def test_pulses_without_sentences_set_the_part_below_a_second():
    """After a loss of power minutes and seconds count from it, and stamps begin anew with the edge of each
    pulse."""
    lost, missing = (
        {"kind": "power_cycle", "at_s": 0.2, "off_s": 0.3},
        {"kind": "missing_sentence", "at_s": 0.0},
    )
    payloads, due_ns = data_of(emulator(lost, missing, clock_error_ppm=100.0).packets(0.0, 2.2))
    stamp_us = stamps_us(payloads)
    fired_us = (due_ns - 1_327_104) / US_NS  # the first pulse is fired at a whole second
    free, pulled = (due_ns > 0.6 * S_NS) & (due_ns < S_NS), due_ns > 1.01 * S_NS
    assert stamp_us[free] == pytest.approx((fired_us[free] - 0.5e6) * 1.0001, abs=1.5)
    assert stamp_us[pulled] == pytest.approx(fired_us[pulled], abs=1.0)


def test_packets_know_their_first_pulse():
    """A packet is stamped as its first pulse is fired, also where the field of view leaves some out."""
    run = emulator(setting(0.1, fov_deg=[90, 180]), setting(0.5, return_mode="dual"))
    packets = list(run.packets(0.0, 1.0))
    fired = [packet.fired_ns for packet in packets if packet.kind is PacketKind.DATA]
    payloads, _ = data_of(packets)
    assert [t_ns // US_NS % 3_600_000_000 for t_ns in fired] == stamps_us(payloads).tolist()
    slots = [row for some in run.parts.units[0].timeline.sequences(0, S_NS) for row in some[:, 0].tolist()]
    assert [run.scenario.start_ns + first * 55_296 for first in slots] == fired
    assert run.parts.units[0].timeline.count(0, S_NS) == len(fired)


def test_a_late_start_reads_the_encoder_only_at_borders(monkeypatch):
    """With a field of view the first packet after an hour is found with fewer than six readings per
    revolution; the next start needs none of them again."""
    unit = load_unit(setting(0.5, fov_deg=[90, 200]), duration_s=7200.0, **{"sensor.preset": "unit"})
    read = []
    whole = Head.read
    monkeypatch.setattr(
        Head, "read", lambda head, sequence: read.append(len(sequence)) or whole(head, sequence)
    )
    early, late, again = (
        (next(unit.timeline.stretches(at_ns, at_ns + S_NS)), sum(read), read.clear())[:2]
        for at_ns in (S_NS, 3600 * S_NS, 3600 * S_NS)
    )
    assert late[1] - early[1] < 6 * 36_000
    assert again == (late[0], pytest.approx(early[1], abs=70_000))


@pytest.mark.parametrize("fov_deg", [[90, 200], [350, 9], [7, 7], [10, 9], [0, 358]])
def test_counts_are_those_of_the_readings(fov_deg):
    """Packets that are counted are those whose firing sequences are in the field of view, one by one,
    through stops, ramps and restarts."""
    events = (
        setting(0.2, fov_deg=fov_deg),
        setting(2.0, rpm=1200),
        {"kind": "motor_stop", "at_s": 6.0, "duration_s": 8.0},
        {"kind": "rpm_wobble", "at_s": 5.0, "duration_s": 9.0, "amplitude_rpm": 90.0, "period_s": 0.9},
        {"kind": "power_cycle", "at_s": 18.0, "off_s": 0.5},
        setting(20.0, fov_deg=fov_deg, phase_lock_deg=11.0),
    )
    unit = load_unit(*events, duration_s=30.0)
    spans = [span for span in unit.timeline.spans if span.fov_deg]
    assert len(spans) == 2
    for span in spans:
        stop = min(span.stop or 500_000, 500_000)
        sent = unit.timeline.in_view(span, span.first, stop)
        for at in range(span.first, stop, 29_998):
            counted = FieldOfView(unit.head, *span.fov_deg).count(span.first, at)
            assert 2 * counted == np.searchsorted(sent, at)


def test_counting_takes_each_change_of_settings_once(monkeypatch):
    """Faults that count packets are set up by bisection: of a thousand changes of the field of view each
    is counted once, however many faults ask."""
    changes = [setting(0.1 * n, fov_deg=[n % 90, 200]) for n in range(1000)]
    timeline = load_unit(*changes, duration_s=200.0).timeline
    counted = []
    whole = FieldOfView.count
    monkeypatch.setattr(
        FieldOfView, "count", lambda field, *span: counted.append(span) or whole(field, *span)
    )
    found = [timeline.count(0, round(at_s * S_NS)) for at_s in np.arange(0.0, 99.0, 0.1)]
    assert found == sorted(found)
    assert len(counted) < 2 * 1000


def test_a_setting_while_the_sensor_starts_holds_from_power_up():
    """Speed, return mode and field of view that are set without power are those of the first packet after
    it; what was set before it is lost."""
    run = emulator(
        setting(0.1, rpm=900),
        {"kind": "power_cycle", "at_s": 0.3, "off_s": 0.5},
        setting(0.5, rpm=1200, return_mode="last", fov_deg=[90, 269]),
    )
    unit = run.parts.units[0]
    before, off, on = (unit.state.operation.at(round(at_s * S_NS)) for at_s in (0.2, 0.6, 0.8))
    assert (before.settings.rpm, off.is_powered, on.settings.rpm) == (900, False, 1200)
    assert [spin.rpm for spin in unit.head.rotor.spins][-1] == 1200
    payloads, due_ns = data_of(run.packets(0.8, 1.2))
    azimuth, _ = blocks_of(payloads)
    assert due_ns[0] > 0.8 * S_NS
    assert set(payloads[:, 1204]) == {0x38}
    assert azimuth.min() >= 9000
    assert azimuth.max() < 27_000
    assert np.median(speeds_rpm(payloads)) == pytest.approx(1200, abs=10)

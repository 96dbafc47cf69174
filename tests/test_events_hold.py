"""Events hold for every reader of a run: scans, points, counts, locks and reports, on the default unit and
in the hall."""

from dataclasses import replace
from threading import Event, Thread

import numpy as np
import pytest

from vlp16emu import Emulator, decode
from vlp16emu.engine import Engine
from vlp16emu.engine.build import gps_input
from vlp16emu.errors import InputError, OutputError
from vlp16emu.extras.bench.changes import gps_of
from vlp16emu.extras.clouds.points import write_points
from vlp16emu.extras.clouds.scan import Chunk, cut_scans
from vlp16emu.run.feed import PacketFeed
from vlp16emu.run.report import turn_of
from vlp16emu.scenario import load
from vlp16emu.types import PacketKind
from vlp16emu.units import S_NS


def setting(at_s, **keys):
    return {"kind": "setting", "at_s": at_s, **keys}


def hall(*events, scene="static_bench", **settings):
    return Emulator(scene, {"duration_s": 1.0, "events": list(events), **settings}, threads=1)


@pytest.mark.parametrize(
    "changed", [{"laser": False}, {"return_mode": "last"}, {"fov_deg": [0, 90]}], ids=str
)
def test_scans_follow_settings_as_the_capture_does(each_unit, changed, tmp_path):
    """Revolutions of the scene have the points of those in its recording, before and after a change of
    settings."""
    emulator = hall(setting(0.3, **changed), scene=each_unit)
    emulator.record(tmp_path / "hall.pcap", duration_s=0.7)
    sent = list(decode(tmp_path / "hall.pcap"))
    scans = list(emulator.scans(duration_s=0.7))[: len(sent)]  # the last packet of a capture is not full
    assert len(sent) >= 2
    assert [len(scan.t_ns) for scan in scans] == [len(scan.t_ns) for scan in sent]
    for scan, other in zip(scans, sent, strict=True):
        assert np.array_equal(scan.is_last, other.is_last)
        assert np.array_equal(scan.ring, other.ring)


def test_a_file_of_points_has_none_while_the_laser_is_off(each_unit, tmp_path):
    """Points of a scene end with the last packet before the laser is switched off, and begin again with
    the first after it."""
    emulator = hall(setting(0.1, laser=False), setting(0.2, laser=True), scene=each_unit)
    write_points(emulator, tmp_path / "points.npz", duration_s=0.3)
    with np.load(tmp_path / "points.npz") as points:
        since_s = (points["t_ns"] - emulator.scenario.start_ns) / 1e9
    assert ((since_s < 0.101) | (since_s > 0.199)).all()
    assert (since_s < 0.1).any()
    assert (since_s > 0.2).any()


def test_a_standing_rotor_holds_no_points():
    """Readings of a rotor that stands are dropped after two seconds, and revolutions after it are whole
    again."""
    longest = 0

    class Counted(Chunk):
        def extended_by(self, later):
            nonlocal longest
            whole = super().extended_by(later)
            longest = max(longest, int(whole.t_ns[-1] - whole.t_ns[0]))
            return Counted(whole.t_ns, whole.azimuth_deg, whole.reading, whole.arrays)

    def chunks():
        turning = np.arange(0.0, 720.0, 0.5) % 360.0
        for number in range(40):
            azimuth_deg = turning if number in (0, 39) else np.full(len(turning), 359.5)
            t_ns = (number * len(turning) + np.arange(len(turning))) * S_NS // 7200
            names = ("distance_m", "azimuth_deg", "ring", "reflectivity", "xyz_m", "is_last")
            arrays = {name: np.zeros(len(t_ns)) for name in names} | {"t_ns": t_ns}
            yield Counted(t_ns, azimuth_deg, np.arange(len(t_ns)), arrays)

    scans = list(cut_scans(chunks()))
    assert [len(scan.t_ns) for scan in scans] == [720] * 3  # the one in which it stops is dropped
    assert longest < 2.3 * S_NS


def off_deg(scenario, phase_deg, seconds):
    """Angles of the rotor at whole UTC seconds of a run, off its phase."""
    rotor = Engine.of(scenario, threads=1).parts.head.rotor
    first_ns = -scenario.start_ns % S_NS
    return (rotor.angle_deg(first_ns + np.array(seconds) * S_NS) - phase_deg + 180.0) % 360.0 - 180.0


@pytest.mark.parametrize(
    "settings",
    [{"sensor.phase_lock_deg": 90.0}, {"events": [setting(1.0, phase_lock_deg=90.0)]}],
    ids=["from the start", "by an event"],
)
def test_a_phase_lock_holds(default_unit, settings):
    """At each whole second of minutes the rotor of a unit with a speed error is within a degree of its
    phase."""
    scenario = load(default_unit, {"duration_s": 200.0, **settings})
    assert abs(off_deg(scenario, 90.0, range(5, 190))).max() < 1.0


def test_a_rotor_wanders_without_its_lock(default_unit):
    """Without lock the error of the mean speed moves the rotor by tens of degrees; the move begins at the
    end of the lock, without a jump."""
    off = setting(60.0, phase_lock_deg="off")
    scenario = load(default_unit, {"duration_s": 200.0, "sensor.phase_lock_deg": 90.0, "events": [off]})
    assert abs(off_deg(scenario, 90.0, range(5, 60))).max() < 1.0
    assert abs(off_deg(scenario, 90.0, range(70, 190))).max() > 20.0
    rotor = Engine.of(scenario, threads=1).parts.head.rotor
    turned_deg = np.diff(rotor.angle_deg(np.arange(0, 200 * S_NS, 1_000_000))) % 360.0
    assert abs(turned_deg - 3.6).max() < 0.02


def test_only_position_packets_that_leave_are_counted(each_unit):
    """What a stream skips through a power cycle is what the sensor would have sent: nothing in the seconds
    without power."""
    emulator = hall({"kind": "power_cycle", "at_s": 0.2, "off_s": 5.0}, scene=each_unit, duration_s=8.0)
    due = [packet.kind for packet in emulator.packets(0.0, 5.3)]
    feed = PacketFeed(emulator.engine, 0.0, 6.0)
    first = next(feed).kind
    feed.go_on_from(emulator.scenario.start_ns + 5_300_000_000)
    next(feed)
    for kind in (PacketKind.DATA, PacketKind.POSITION):
        assert feed.skipped[kind] == due.count(kind) - (first is kind)


def test_copies_of_packets_survive_a_change_of_settings(each_unit):
    """A packet and its copy, due at one instant, are both sent when packets are computed again with other
    settings."""
    emulator = hall({"kind": "duplicate", "at_s": 0.0, "count": 1_000_000}, scene=each_unit)
    whole = list(PacketFeed(emulator.engine, 0.0, 0.05))
    feed = PacketFeed(emulator.engine, 0.0, 0.05)
    first = next(feed)
    feed.begin_again(2**62, emulator.engine)
    assert [first, *feed] == whole


def test_a_new_input_is_spared(tmp_path):
    """A mesh that `changed` brings into the scene is no output, as if the scene had named it from the
    start."""
    mesh = tmp_path / "box.ply"
    mesh.write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 1\n3 0 1 2\n"
    )
    before = mesh.read_bytes()
    table = {"file": str(mesh), "unit": "m", "up": "z", "places": [{"x_m": 2.0, "y_m": 2.0}]}
    emulator = Emulator("static_bench").changed({"world.meshes": [table]})
    with pytest.raises(OutputError, match="input"):
        write_points(emulator, mesh, duration_s=0.01)
    assert mesh.read_bytes() == before


def test_two_runs_of_an_emulator_end_each_by_its_own_stop(tmp_path):
    """A recording that is stopped beside another one leaves the other, and the emulator, as they are."""
    emulator = hall(duration_s=60.0)
    stop, begun = Event(), Event()
    done = []
    stopped = Thread(
        target=lambda: emulator.record(tmp_path / "a.pcap", stop=stop, progress=lambda _: begun.set()),
        daemon=True,
    )
    other = Thread(
        target=lambda: done.append(emulator.record(tmp_path / "b.pcap", duration_s=2.0, stop=Event())),
        daemon=True,
    )
    stopped.start()
    other.start()
    assert begun.wait(60)
    stop.set()
    for thread in (stopped, other):
        thread.join(60)
    assert not done[0].interrupted
    assert done[0].sha256 == hall(duration_s=60.0).record(tmp_path / "c.pcap", duration_s=2.0).sha256
    assert len(list(emulator.scans(duration_s=0.25))) == 2


@pytest.mark.parametrize("name", ["sped", "emulator", "options"])
@pytest.mark.parametrize("verb", ["record", "stream"])
def test_a_wrong_option_is_an_input_error(verb, name, tmp_path):
    """An option that does not exist is named with those that do, whatever else has that name inside."""
    run = getattr(Emulator("static_bench"), verb)
    with pytest.raises(InputError, match=f"{name}: unknown option; expected one of .*duration_s"):
        run(*[tmp_path / "x.pcap"][: verb == "record"], **{name: 2})


def test_the_report_gives_the_speed_that_ran():
    """After a change of speed a report has the mean of the set speed over its span, and the revolutions of
    that span."""
    head = hall(setting(0.0, rpm=1200), duration_s=20.0).parts.head
    turn = turn_of(head, 10.0, 20.0)
    assert (turn.rpm, turn.revolutions) == (pytest.approx(1200.0), pytest.approx(200.0))
    steady = turn_of(hall().parts.head, 0.0, 1.0)
    assert (steady.rpm, steady.revolutions) == (600.0, 10.0)


def test_set_up_takes_each_event_once():
    """Ten times as many events of the receiver ask at most twelve times as often for its state."""

    def asked(count):
        times = [{"kind": "wrong_sentence", "at_s": 9.0 * n, "duration_s": 2.0} for n in range(count)]
        scenario = load("static_bench", {"duration_s": 9.0 * count, "gps.connected": True, "events": times})
        return len(
            gps_of(gps_input(scenario.gps, scenario.seed), scenario.events, scenario.start_ns)._turns_ns()
        )

    assert asked(500) <= 12 * asked(50)


def test_lost_records_keep_their_range(default_unit):
    """A record that a unit loses has distance 0 and keeps the range that it would have had, as the type
    says."""
    emulator = hall(scene=default_unit, **{"sensor.return_mode": "dual"})
    lost = 0
    for returns in emulator.returns(0.0, 0.3, truth=True):
        first = returns.distance_m[..., 0]
        lost += np.count_nonzero((first == 0.0) & (returns.range_m[..., 0] > 0.0))
    assert lost > 0


def test_an_engine_is_a_value():
    """An engine for one run shares world and windows with the engine that it comes from, which stays as it
    is."""
    engine = hall().engine
    stop = Event()
    one = engine.stopped_by(stop)
    stop.set()
    assert one.parts is engine.parts
    assert one.windows.stop.is_set()
    assert not engine.windows.stop.is_set()
    assert replace(one, threads=2).windows is one.windows

"""Statistics that distinguish units, on our captures and on real ones."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from kit import real_capture

from vlp16emu import Emulator
from vlp16emu.errors import CaptureError, InputError
from vlp16emu.extras.compare import compare_statistics, fit_settings, read_sequences, statistics_of
from vlp16emu.packets import DATA_PAYLOAD
from vlp16emu.sensor.beams import MODELS
from vlp16emu.sinks import PcapSink
from vlp16emu.types import Packet, PacketKind, SensorModel

CAPTURES = Path(__file__).resolve().parents[4] / "shared" / "captures"
LAWS = Path(__file__).parents[3] / "vlp16emu/sensor/laws.toml"
UNIT = {"noise.preset": "unit", "sensor.preset": "unit", "sensor.eccentricity_deg": 0.06}
BEAT = {"noise.range_beat_m": 0.0055, "noise.range_beat_phase_deg": 123.0}


KNOWN = {
    "sensor.rotation_spread": 0.0,
    "sensor.speed_error_rpm": -0.9,
    "sensor.speed_wander_rpm": 0.0,
    "sensor.hum_deg": 0.002,
    "sensor.clock_error_ppm": 12.0,
    "noise.gain_spread": 0.06,
    "noise.gain_by_range": 0.15,
    "noise.range_noise_m": 0.007,
    "noise.unit_spread": 0.0,
}
SHORT_SIGHTED = {"sensor.max_range_m": 14, "beam.model": "adaptive"}  # some of the hall is out of reach


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Record 0.4 s of the bench, or of a scene, with some settings, and read it."""

    def record(name, settings, duration_s=0.4, scene="static_bench"):
        path = tmp_path_factory.mktemp("compare") / f"{name}.pcap"
        Emulator(scene, settings).record(path, duration_s=duration_s)
        return read_sequences(path)

    return record


@pytest.fixture(scope="module")
def real(tmp_path_factory):
    """Captures of four real units, those without frames put into some."""
    if not CAPTURES.is_dir():
        pytest.skip("no real captures beside the repository")

    def framed(name, stamps_ns):
        path, payloads = tmp_path_factory.mktemp("real") / f"{name}.pcap", (CAPTURES / name).read_bytes()
        with PcapSink(path) as sink:
            for i, stamp_ns in zip(range(len(payloads) // 1206), stamps_ns, strict=False):
                sink.send(Packet(PacketKind.DATA, stamp_ns, payloads[1206 * i : 1206 * (i + 1)]))
        return path

    stamps = map(int, (CAPTURES / "nebula_vlp16_dual.stamps_ns.txt").read_text().split())
    paths = {
        "mrpt": CAPTURES / "mrpt_vlp16_gps.pcap",
        "nebula": framed("nebula_vlp16_dual.bin", stamps),
        "einride": framed("einride_vlp16.bin", range(10**18, 2 * 10**18, 1_327_104)),
        "2014": CAPTURES / "rust_lidar_vlp16_2014.pcap",
    }
    return {name: read_sequences(path) for name, path in paths.items()}


def test_known_settings_come_back_from_our_own_packets(recorded):
    """Beat within 0.3 mm and 3 deg, noise within 5 %, speed within 0.06 rpm, tick within 20 %, rate of the
    clock within 0.3 ppm, gain within a third.

    The middle of what no-returns carry is found within 40 %, the spread of its lasers, and the rate of lost
    records within 40 %, as only a few dozen are lost here. Two revolutions of lost packets change nothing.
    """
    known = KNOWN | {
        "noise.records_lost": 1.0,
        "noise.no_return_level": 14.0,
        "noise.no_return_wander": 0.5,
        "events": [{"kind": "drop", "at_s": 0.3, "duration_s": 0.21}],
    }
    tables = fit_settings(recorded("known", UNIT | BEAT | SHORT_SIGHTED | known, 1.1))
    noise, sensor = tables["noise"], tables["sensor"]
    assert noise["range_beat_m"] == pytest.approx(0.0055, abs=0.0003)
    assert noise["range_beat_phase_deg"] == pytest.approx(123.0, abs=3.0)
    assert noise["range_noise_m"] == pytest.approx(0.007, rel=0.05)
    assert noise["gain_spread"] == pytest.approx(0.06, rel=0.33)
    assert noise["range_counts"]
    assert noise["no_return_level"] == pytest.approx(14.0, rel=0.4)
    assert noise["records_lost"] == pytest.approx(1.0, rel=0.4)
    assert sensor["eccentricity_deg"] == pytest.approx(0.06, abs=0.003)
    assert sensor["eccentricity_phase_deg"] == pytest.approx(40.0, abs=3.0)
    assert sensor["twice_per_turn_deg"] == pytest.approx(0.008, abs=0.002)
    assert sensor["speed_error_rpm"] == pytest.approx(-0.9, abs=0.06)
    assert sensor["hum_deg"] == pytest.approx(0.002, rel=0.2)
    assert sensor["clock_error_ppm"] == pytest.approx(12.0, abs=0.3)


@pytest.mark.parametrize("scene", ["furnished", "birch_walk"])
def test_the_rate_of_lost_records_comes_back_from_any_scene(tmp_path, scene):
    """Half of the rates of a median unit, and all of them, are found within 30 % among furniture and among
    trees, although spots and gaps between leaves leave records without a return too."""
    found = {}
    for factor in (0.5, 1.0):
        path = tmp_path / f"{factor}.pcap"
        own = {"noise.unit_spread": 0.0, "noise.records_lost": factor, "noise.spots_lost": 1.0}
        Emulator(scene, own).record(path, duration_s=1.0)
        found[factor] = fit_settings(read_sequences(path))["noise"]["records_lost"]
    assert found == {factor: pytest.approx(factor, rel=0.3) for factor in found}


@pytest.mark.parametrize("model", ["puck-hi-res", "hdl-32e", "vlp-32c", "vls-128"])
def test_known_settings_of_other_models_come_back(recorded, model):
    """Model, beat, noise, gain, speed and encoder of each model are found, with its lasers, codes and times.

    The rate of the clock is left out where units have a period of their own, remainders of ranges where the
    unit of distance is another one, and what is known of readings 110.592 us apart where they are not.
    """
    known = KNOWN | {"sensor.model": model, "sensor.return_mode": "dual"}
    sequences = recorded(model, UNIT | BEAT | SHORT_SIGHTED | known)
    found = fit_settings(sequences)
    noise, sensor = found["noise"], found["sensor"]
    of_model = MODELS[SensorModel(model)]
    assert (sensor["model"], sensor["return_mode"]) == (model, "dual")
    assert noise["range_beat_m"] == pytest.approx(0.0055, abs=0.0003)
    assert noise["range_beat_phase_deg"] == pytest.approx(123.0, abs=3.0)
    assert noise["range_noise_m"] == pytest.approx(0.007, rel=0.05)
    assert noise["gain_spread"] == pytest.approx(0.06, rel=0.33)
    assert sensor["eccentricity_deg"] == pytest.approx(0.06, abs=0.003)
    assert sensor["speed_error_rpm"] == pytest.approx(-0.9, abs=0.06)
    assert sensor["hum_deg"] == pytest.approx(0.002, rel=0.2)
    assert ("clock_error_ppm" in sensor) == (of_model.period_us is None)
    assert sensor.get("clock_error_ppm", 12.0) == pytest.approx(12.0, abs=0.5)
    assert ("range_counts" in noise) == (of_model.distance_lsb_m == 0.002)
    assert ("encoder_rate_error" in sensor) == (of_model.beams.per_reading == 2)
    same = compare_statistics(sequences, sequences)
    assert len(same) > 12
    assert not any(row.distance or row.apart for row in same)
    assert of_model.lasers == 16 or not any(any(row.unlike) for row in same)


def test_other_models_have_no_beat():
    """A real HDL-32E has none with the period of a VLP-16's, whose least is 3.8 mm; its noise is 12 mm."""
    found = statistics_of(read_sequences(real_capture("mrpt_hdl32e.pcap")))
    assert found["range.beat_mm"] < 0.2
    assert found["range.white_at_20_mm"] == pytest.approx(11.6, abs=0.2)
    assert found["rotation.speed_off_percent"] < 0.5


def test_a_unit_without_character_is_unlike_any_real_one(recorded):
    """The beat, counts of 4 mm, and the error twice a turn are missed; with the presets `unit` they are as on
    real units.

    It loses no record. Two units of seeds of their own differ in the phase of the beat and have counts; none
    differs from itself.
    """
    wanted = {"range.beat_mm", "residue.even_at_equal_codes", "rotation.twice_cdeg"}
    plain = recorded("plain", {"noise.preset": "typical", "sensor.eccentricity_deg": 0.06} | SHORT_SIGHTED)
    unit, other = (recorded(f"unit {seed}", UNIT | {"seed": seed}) for seed in (11, 13))
    same = compare_statistics(unit, unit)
    assert len(same) > 12
    assert not any(row.distance or row.apart for row in same)
    one, two = (fit_settings(sequences)["noise"] for sequences in (unit, other))
    assert abs(one["range_beat_phase_deg"] - two["range_beat_phase_deg"]) > 10
    assert [one["range_counts"], two["range_counts"], fit_settings(plain)["noise"]["range_counts"]] == [
        True,
        True,
        False,
    ]
    assert fit_settings(plain)["noise"]["records_lost"] < 0.1
    unlike = {row.name: row.unlike for row in compare_statistics(plain, unit)}
    assert {name: unlike[name] for name in wanted} == dict.fromkeys(wanted, (True, False))


@pytest.fixture(scope="module")
def statistics(real):
    """Statistics of the real units, by capture."""
    return {name: statistics_of(sequences) for name, sequences in real.items()}


def test_the_beat_of_real_units_is_found(statistics):
    """Amplitudes of 3.5 to 7.5 mm, which the four captures show."""
    beats = {name: found["range.beat_mm"] for name, found in statistics.items()}
    assert all(3.5 < beat_mm < 7.5 for beat_mm in beats.values())
    assert beats["mrpt"] == pytest.approx(6.0, abs=0.2)


UNITS = {"A": "mrpt", "B": "nebula", "C": "einride", "D": "2014"}
"""Captures by the letters of `sensor/laws.toml`, in the order of protocol/README.md."""


@pytest.mark.parametrize(
    ("section", "law", "statistic", "tolerance"),
    [
        ("clock", "spread_ppm", "clock.error_ppm", 0.01),
        ("range", "beat", "range.beat_mm", 0.1),
        ("code", "gain_neighbours", "reflectivity.gain_spread", 0.001),
    ],
)
def test_a_law_names_the_unit_that_its_capture_shows(statistics, section, law, statistic, tolerance):
    """The values by unit in the source of a law are those of the units' captures."""
    laws = tomllib.loads(LAWS.read_text(encoding="utf-8"))
    stated = dict(re.findall(r"\b([ABCD]) (-?[\d.]+\d)", laws[section][law]["source"]))
    for letter, name in UNITS.items():
        value = statistics[name].get(statistic)
        assert value is None or float(stated[letter]) == pytest.approx(value, abs=tolerance)


def test_clock_errors_stand_in_the_order_of_the_table(statistics):
    """protocol/README.md has the clock errors of units in the order of the head of its table."""
    page = (LAWS.parents[2] / "protocol/README.md").read_text(encoding="utf-8")
    (errors,) = re.findall(r"stamps against firing ([-\d., ]+) ppm", page)
    assert "| Effect | Measured: mrpt, nebula, einride, 2014 |" in page
    for name, stated in zip(UNITS.values(), errors.split(", "), strict=True):
        error_ppm = statistics[name].get("clock.error_ppm")
        assert error_ppm is None or float(stated) == pytest.approx(error_ppm, abs=0.01)


def settings_of(sequences):
    tables = fit_settings(sequences)
    return {f"{section}.{key}": value for section, table in tables.items() for key, value in table.items()}


FITTED = (
    *("range.beat", "range.white", "reflectivity.equal_60", "reflectivity.scatter_60"),
    *("reflectivity.comb", "reflectivity.gain", "lost.on_a_surface"),
    *("no_return.above_0", "no_return.mean", "rotation.o", "rotation.r", "residue."),
)
"""Beginnings of the names of statistics that follow from keys which `fit` gives."""


@pytest.mark.parametrize("name", ["mrpt", "nebula", "einride", "2014"])
def test_no_statistic_of_a_fitted_unit_is_apart(real, recorded, name):
    """A recording in a furnished hall with the tables that fit a capture is in no fitted statistic farther
    from it than real units are from each other."""
    fitted_unit = recorded(f"as_{name}", settings_of(real[name]), 0.8, scene="furnished")
    rows = compare_statistics(fitted_unit, real[name])
    assert not [row for row in rows if row.apart and row.name.startswith(FITTED)]


def turning(path, rpm, count=200):
    """Capture of packets without returns of a rotor at some speed."""
    payload = np.zeros(count, DATA_PAYLOAD)
    turned_cdeg = np.arange(count * 12) * 110.592e-6 * rpm * 600
    payload["blocks"]["flag"], payload["return_mode"], payload["factory"] = 0xEEFF, 0x37, 0x22
    payload["blocks"]["azimuth_cdeg"] = turned_cdeg.reshape(count, 12) % 36_000
    payload["timestamp_us"] = np.arange(count) * 1327.104
    with PcapSink(path) as sink:
        for i, data in enumerate(payload):
            sink.send(Packet(PacketKind.DATA, i * 1_327_104, data.tobytes()))
    return path


@pytest.mark.parametrize(
    ("rpm", "count", "line"),
    [
        *((rpm, 200, r"a rotor at .* rpm; expected 300 to 1200 rpm") for rpm in (0, 20, 1860)),
        (600, 1, r"1 data packets; expected 80 at least"),
    ],
)
def test_a_rotor_that_no_vlp16_can_have_is_refused(tmp_path, rpm, count, line):
    """The manual (63-9243 Rev D, section 8.3) has 300 to 1200 rpm: a rotor that stands or runs up is one
    line, as is less than a revolution."""
    with pytest.raises(CaptureError, match=line):
        read_sequences(turning(tmp_path / "a.pcap", rpm, count))


@pytest.mark.parametrize(
    ("mean_rpm", "rpm", "off_rpm"),
    [(499.6, 500, -0.48), (602.5, 600, 2.5), (1197.9, 1200, -1.05), (483, 483, 0.0)],
)
def test_the_speed_of_a_capture_is_one_that_a_scene_takes(tmp_path, mean_rpm, rpm, off_rpm):
    """A rotor at 499.6 rpm is fitted as one that is set to 500, which a scene takes and `compare` calls
    0.08 % off; a multiple of 60 within the error of a held speed goes first, and any other speed is set as it
    is."""
    sequences = read_sequences(turning(tmp_path / "a.pcap", mean_rpm))
    sensor = fit_settings(sequences)["sensor"]
    assert sensor["rpm"] == rpm
    assert sensor["speed_error_rpm"] == pytest.approx(off_rpm, abs=0.01)
    off_percent = statistics_of(sequences)["rotation.speed_off_percent"]
    assert off_percent == pytest.approx(abs(mean_rpm / rpm - 1) * 100, abs=3e-3)


def test_a_unit_that_was_fitted_at_500_rpm_turns_at_its_speed(recorded):
    """A recording of a unit at 500 rpm, fitted and recorded again, has its speed within 0.06 rpm."""
    first = recorded("at 500", UNIT | BEAT | {"sensor.rpm": 500, "sensor.speed_error_rpm": -0.48}, 0.5)
    again = recorded("again", settings_of(first), 0.5)
    assert again.rpm == pytest.approx(first.rpm, abs=0.06)
    assert 498.5 < again.rpm < 500.2


def test_the_step_of_codes_and_the_kinds_of_losses_come_back(recorded):
    """The factor beyond 8 m of two units is found within a quarter, the rates of losses at steps within 30 %,
    and more losses in spots raise their factor alone."""
    hall = {"noise.unit_spread": 0.0, "noise.records_lost": 1.0, "world.texture": 0.25, "world.shading": 0.3}
    hall["beam.model"] = "adaptive"  # a ray without a width meets one surface
    fitted = [
        fit_settings(recorded(f"steps {step} {spots}", UNIT | hall | own))["noise"]
        for step, spots in ((1.2, 0.5), (2.0, 4.0))
        if (own := {"noise.reflectivity_far_step": step, "noise.spots_lost": spots})
    ]
    assert fitted[0]["reflectivity_far_step"] == pytest.approx(1.2, rel=0.25)
    assert fitted[1]["reflectivity_far_step"] == pytest.approx(2.0, rel=0.25)
    assert fitted[1]["spots_lost"] > 2.0 * fitted[0]["spots_lost"]
    assert [noise["records_lost"] for noise in fitted] == pytest.approx([1.0, 1.0], rel=0.3)


def test_what_no_setting_makes_is_compared_but_not_fitted(recorded, tmp_path):
    """280 rpm is less than a unit can be set to: `compare` measures it, 6.7 % off, and `fit` says why no
    setting makes it; so with a sawtooth by flipped bits."""
    sequences = read_sequences(turning(tmp_path / "a.pcap", 280))
    assert statistics_of(sequences)["rotation.speed_off_percent"] == pytest.approx(20 / 3, rel=1e-3)
    with pytest.raises(InputError, match=r"a mean speed of 280.0 rpm; expected a speed of a unit within 3"):
        fit_settings(sequences)
    corrupt = {"events": [{"kind": "corrupt", "at_s": 0.2, "share": 0.1}]}
    with pytest.raises(InputError, match=r"^hum_deg: found 0\.\d+; expected a number from 0 to 0\.02$"):
        fit_settings(recorded("corrupt", corrupt, 0.7))
    rows = (fit_settings(read_sequences(turning(tmp_path / "a.pcap", rpm)))["sensor"] for rpm in (300, 600))
    assert ["encoder_rate_error" in row for row in rows] == [False, True]

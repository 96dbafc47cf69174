"""Position packets: sentences that follow the walk and the canopy."""

import pytest
from listening import parse_rmc
from woods import LINES

from vlp16emu import Emulator
from vlp16emu.engine.engine import position_packets
from vlp16emu.packets import decode_position
from vlp16emu.scenario import load
from vlp16emu.units import S_NS

pytestmark = pytest.mark.usefixtures("kept_woods")

FOREST = [*LINES, "gps.canopy_half_cover=0.15"]


@pytest.fixture(scope="module")
def birch():
    """A thin forest, with a receiver that trees disturb easily."""
    return Emulator(load("birch_walk", [*FOREST, "sensor.preset=steady"]), threads=2)


def sentences(emulator, receiver, start_s, stop_s):
    parts, span_ns = emulator.parts, (round(start_s * S_NS), round(stop_s * S_NS))
    packets = position_packets(emulator.scenario, receiver, parts.units[0], *span_ns)
    return [decode_position(packet.payload).sentence for packet in packets]


def test_sentences_do_not_depend_on_how_a_run_is_cut(birch):
    """Any second can be had first, and from another emulator: the sentences are the same, lost fixes
    included."""
    whole = sentences(birch, birch.engine.receiver, 0.0, 6.0)
    assert {parse_rmc(sentence).valid for sentence in whole} == {True, False}
    other = Emulator(birch.scenario, threads=1)
    late = sentences(other, other.engine.receiver, 3.2, 6.0)
    assert late == whole[-len(late) :]
    early = sentences(other, other.engine.receiver, 0.0, 3.2)
    assert early + late == whole


def test_the_receivers_windows_are_those_of_the_run(birch):
    """A run of two segments with its receiver opens each window once."""
    opened, emulator = [], Emulator(birch.scenario)
    world = emulator.parts.world

    class Counting:
        def window(self, track_m):
            """Count, and look through."""
            opened.append(track_m)
            return world.window(track_m)

        shape, seed = world.shape, world.seed

    object.__setattr__(emulator.parts, "world", Counting())
    assert list(emulator.packets(6.6, 7.0))
    assert len(opened) == 2


WORST = [
    "gps.position_noise_m=1000",
    "gps.wander_m=1000",
    "gps.wander_s=1",
    "gps.velocity_noise_m_s=100",
    "gps.canopy_error_factor=100",
    "gps.latitude_deg=89.999",
]


@pytest.mark.parametrize("settings", [["gps.velocity_noise_m_s=30"], WORST], ids=["30 m/s", "worst"])
def test_no_error_of_the_receiver_ends_a_run(settings):
    """With the greatest errors that a scene may give, and under a roof, each second still has a sentence
    of at most 82 bytes."""
    emulator = Emulator(load("static_bench", ["gps.connected=true", *settings]))
    spoken = set(sentences(emulator, emulator.engine.receiver, 0.0, 12.0))
    assert len(spoken) == 13
    assert max(map(len, spoken)) <= 82
    assert 50.0 < max(parse_rmc(sentence).speed_m_s for sentence in spoken) < 514.0


@pytest.mark.parametrize("rate", ["measured", "manual"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_no_position_packet_is_older_than_its_sensor(rate, seed):
    """Without GPS the first stamp, written 350 us before its packet leaves, is not before power-up, and
    stamps grow from there; there is no sentence."""
    settings = [f"seed={seed}", f"sensor.position_rate={rate}", "gps.connected=false"]
    scenario = load("static_bench", settings)
    emulator = Emulator(scenario)
    packets = position_packets(scenario, None, emulator.parts.units[0], 0, S_NS)
    said = [decode_position(packet.payload) for packet in packets]
    assert {one.sentence for one in said} == {b""}
    stamps_ns = [one.time_ns for one in said]
    assert 0 <= stamps_ns[0] <= 30_000
    assert stamps_ns == sorted(stamps_ns)
    assert stamps_ns[-1] < S_NS

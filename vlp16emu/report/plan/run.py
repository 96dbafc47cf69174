"""From a chain that has not run to its plan."""

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass

from vlp16emu.engine import Engine
from vlp16emu.report.keeping_up import settings_that_keep_up, speed_beside_sender
from vlp16emu.report.plan.forecast import Forecast, Spent, forecast
from vlp16emu.report.plan.needs import Need, Surroundings, libraries, needs, surroundings
from vlp16emu.report.plan.trial import Trial, try_out
from vlp16emu.sinks import sending_share

_SENT_S = 0.4
"""Of packets that are sent, to no other program, in order to measure what sending takes."""


@dataclass(frozen=True, slots=True)
class RunForecast(Forecast):
    """What a recording will take."""

    first_packet_s: float
    """From the start of the command on."""
    peak_memory_bytes: int | None
    """None where the system does not report it."""


@dataclass(frozen=True, slots=True)
class Measured:
    """What a forecast is made from."""

    simulated_s: float
    """Of all pieces."""
    pieces: tuple[Spent, ...]
    second_window: Spent


@dataclass(frozen=True, slots=True)
class StreamOutlook:
    """Whether a stream keeps up in real time."""

    keeps_up: bool
    real_time_factor: float
    """The engine's, beside the thread that sends."""
    sender_share: float
    """Of a core, that sending takes."""
    keeps_up_with: tuple[str, ...]
    """Options of `vlp16emu stream` that are enough, each by itself; none where it keeps up."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What a run needs and leaves out, what it will take, and whether a stream of it keeps up."""

    scene: str
    """Name, path or title."""
    title: str
    seed: int
    duration_s: float
    threads: int
    features: tuple[Need, ...]
    world: Surroundings
    libraries: Mapping[str, bool]
    """Which are loaded."""
    forecast: RunForecast
    measured: Measured
    stream: StreamOutlook


def plan_run(chain: Engine, stop_s: float, threads: int, began: Spent, *, scene: str, audited: bool) -> Plan:
    """Carry out short pieces of a run, and extrapolate.

    Parameters
    ----------
    stop_s : end of the run, since the first pulse
    threads : of the chain
    began : reading of the clocks at the start of the command
    scene : its name in the plan
    audited : whether pulses of the run are cast again

    Raises
    ------
    InputError
        where the walk is too short, or too short to measure on
    """
    chain.packets(0.0, stop_s)  # checks the span
    trial, scenario = try_out(chain, stop_s, threads, began), chain.scenario
    loaded, expected = libraries(), _forecast(trial, stop_s, threads)
    return Plan(
        scene=scene,
        title=scenario.title,
        seed=scenario.seed,
        duration_s=stop_s,
        threads=threads,
        features=tuple(needs(chain, audited=audited)),
        world=surroundings(chain, trial.windows),
        libraries=loaded,
        forecast=expected,
        measured=Measured(
            sum(piece.simulated_s for piece in trial.pieces), trial.pieces, trial.second_window
        ),
        stream=_stream(chain, expected.steady_factor, stop_s, threads),
    )


def _forecast(trial: Trial, stop_s: float, threads: int) -> RunForecast:
    """Extrapolate to the whole run."""
    expected = forecast(
        until_first_packet=trial.until_first_packet,
        pieces=trial.pieces,
        windows=trial.windows - 1,
        per_window=trial.second_window,
        simulated_s=stop_s,
        spare=max((os.cpu_count() or 1) / threads, 1.0),
    )
    return RunForecast(
        **asdict(expected),
        first_packet_s=trial.until_first_packet.wall_s,
        peak_memory_bytes=trial.peak_bytes,
    )


def _stream(chain: Engine, engine_speed: float, stop_s: float, threads: int) -> StreamOutlook:
    """Measure what sending takes, and compare."""
    share = sending_share(list(chain.packets(0.0, min(_SENT_S, stop_s))))
    speed = speed_beside_sender(engine_speed, share, threads, os.cpu_count() or 1)
    keeps_up = speed >= 1.0
    options = [] if keeps_up else settings_that_keep_up(chain.scenario, speed, 1.0)
    return StreamOutlook(keeps_up, speed, share, tuple(options))

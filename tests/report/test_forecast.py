"""From pieces of a run to the whole."""

import pytest

from vlp16emu.report import Forecast, Spent, forecast

START = Spent(3.0, 4.0, 0.1)
PIECES = [Spent(1.0, 2.0, 0.5), Spent(3.0, 6.0, 1.5)]


def forecast_of(**changes):
    usual = {
        "until_first_packet": START,
        "pieces": PIECES,
        "windows": 0,
        "per_window": Spent(0.0, 0.0),
        "simulated_s": 10.1,
        "spare": 1.0,
    }
    return forecast(**usual | changes)


def test_a_run_is_its_start_and_so_many_pieces():
    """Ten seconds at two seconds of clock and four of processor each, after the start's own."""
    assert forecast_of() == Forecast(
        wall_s=pytest.approx(23.0),
        cpu_s=pytest.approx(44.0),
        real_time_factor=pytest.approx(10.1 / 23.0),
        steady_factor=pytest.approx(0.5),
    )


def test_windows_cost_time_where_no_core_is_idle():
    """Two windows of five processor seconds take five seconds of two cores that are busy anyhow."""
    assert forecast_of(windows=2, per_window=Spent(9.0, 5.0)).wall_s == pytest.approx(28.0)


def test_windows_are_free_on_a_core_of_their_own():
    """Where as many cores again are idle, windows cost processor time only, until they are the greater part."""
    little = forecast_of(windows=2, per_window=Spent(9.0, 5.0), spare=2.0)
    assert (little.wall_s, little.cpu_s) == (pytest.approx(23.0), pytest.approx(54.0))
    assert forecast_of(windows=20, per_window=Spent(9.0, 5.0), spare=2.0).wall_s == pytest.approx(
        3.0 + 140 / 4
    )


def test_a_run_that_ends_with_its_first_packet_costs_its_start():
    """A run shorter than what was simulated until the first packet takes no more than that."""
    short = forecast_of(simulated_s=0.05)
    assert (short.wall_s, short.cpu_s) == (3.0, 4.0)


def test_no_pieces_no_forecast():
    """Without anything simulated there is nothing to extrapolate."""
    with pytest.raises(ValueError, match="pieces: found 0 simulated seconds"):
        forecast_of(pieces=[])

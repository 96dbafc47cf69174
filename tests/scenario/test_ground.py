"""The `[world.terrain]` table."""

import pytest
from pydantic import ValidationError

from vlp16emu.forest.ground.settings import Terrain
from vlp16emu.forest.presets import with_preset


def test_rolling_is_what_nothing_gives():
    """A table without keys is the same ground as one that says rolling."""
    assert Terrain.model_validate({"relief": "rolling"}) == Terrain()


@pytest.mark.parametrize("relief", ["flat", "hilly", "rough"])
def test_a_relief_gives_what_is_not_given_beside_it(relief):
    """A relief sets the keys of relief and leaves slope alone; each can be given beside it."""
    plain = Terrain.model_validate({"relief": relief})
    assert plain.model_dump(exclude={"relief"}) != Terrain().model_dump(exclude={"relief"})
    assert plain.slope_deg == 0.0
    own = Terrain.model_validate({"relief": relief, "hill_rms_m": 7.0, "slope_deg": 3.0})
    assert own == plain.model_copy(update={"hill_rms_m": 7.0, "slope_deg": 3.0})


def test_reliefs_are_in_order_of_height_and_of_roughness():
    """Hilly ground has the highest hills, rough ground the roughest soil and the most mounds, flat ground the least of all."""
    flat, rolling, hilly, rough = (
        Terrain.model_validate({"relief": relief}) for relief in ("flat", "rolling", "hilly", "rough")
    )
    assert flat.hill_rms_m == 0 < rolling.hill_rms_m < rough.hill_rms_m < hilly.hill_rms_m
    assert flat.rough_rms_m < rolling.rough_rms_m <= hilly.rough_rms_m < rough.rough_rms_m
    assert flat.mounds_per_ha <= rolling.mounds_per_ha < hilly.mounds_per_ha < rough.mounds_per_ha


def test_an_unknown_relief_is_refused():
    """A relief that is no known word is an error of that key alone."""
    for relief in ("steep", 3, ["flat"]):
        with pytest.raises(ValidationError) as caught:
            Terrain.model_validate({"relief": relief})
        assert [error["loc"] for error in caught.value.errors()] == [("relief",)]


def test_a_relief_of_ones_own_outdoes_that_of_a_forest_preset():
    """A scene that names a relief beside a forest preset gets that relief and none of the preset's numbers."""
    table = with_preset({"preset": "old_growth", "terrain": {"relief": "flat"}}, ())
    assert table["terrain"] == {"relief": "flat"}

"""Ground with relief, or with heights from a file."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from vlp16emu.settings import NonNegative, Place, Positive, Preset, SceneFile, Section

_RELIEFS: dict[str, dict[str, object]] = {
    # Smooth and rough micro-relief have 0.05 m and 0.25 m rms over wavelengths of 0.3 m to 60 m (assumption);
    # of a spectrum of the third power, 1 m to 12 m holds sqrt((12 - 1) / (60 - 0.3)) = 0.43 of that.
    "flat": {"hill_rms_m": 0.0, "rough_rms_m": 0.02},
    "rolling": {},
    "hilly": {"hill_rms_m": 4.0, "mounds_per_ha": 100.0},
    "rough": {"hill_rms_m": 1.5, "rough_rms_m": 0.11, "mounds_per_ha": 800.0},
}
"""Keys that each kind of relief gives. Hills and mounds are assumptions: hills of 1 m rms slope by 4 degrees rms,
of 4 m by 15."""

_NARROWEST_M = 10.0  # least distance between trails


def _room_for_trails(spacing_m: float) -> float:
    if 0 < spacing_m < _NARROWEST_M:
        raise ValueError(f"0 for none, or {_NARROWEST_M:g} or more")
    return spacing_m


class Terrain(Preset):
    """Ground with relief: hills, roughness that a foot would feel, and mounds."""

    presets = _RELIEFS
    preset_key = "relief"

    relief: Literal["flat", "rolling", "hilly", "rough"] = "rolling"
    """Gives those of the next three keys that are not given beside it; `rolling` is as they are by default."""
    hill_rms_m: NonNegative = 1.0
    """Standard deviation of height over wavelengths of 30 m to 300 m."""
    rough_rms_m: NonNegative = 0.06
    """Standard deviation of height over wavelengths of 1 m to 12 m."""
    mounds_per_ha: Annotated[float, Field(ge=0, le=2500)] = 0.0
    """Mounds and hollows of up to 0.15 m, 1 m to 2 m wide."""
    pits_per_ha: Annotated[float, Field(ge=0, le=600)] = 0.0
    """Pits with a mound beside each, as uprooted trees leave them: 0.2 m to 0.4 m deep and high, 2 m to 3 m wide."""
    trail_spacing_m: Annotated[float, Field(ge=0, le=200), AfterValidator(_room_for_trails)] = 0.0
    """Distance between the middles of parallel trails of harvesters, each with two ruts, 0.05 m to 0.2 m deep and 0.5 m to 0.7 m
    wide, 2 m apart; 0 for none, else 10 or more. Trees and shrubs that grow keep 2 m off their middles. Forests of Central Europe have
    trails every 20 m (PEFC) or 40 m (FSC)."""
    trail_towards_deg: Annotated[float, Field(ge=0, lt=360)] = 0.0
    """Direction of the trails, counter-clockwise from east."""
    slope_deg: Annotated[float, Field(ge=0, le=45)] = 0.0
    """Slope of the plane under it all, rising towards `slope_towards_deg`."""
    slope_towards_deg: Annotated[float, Field(ge=0, lt=360)] = 0.0
    """Direction of that slope, counter-clockwise from east."""


class Dem(Section):
    """Heights of the ground in a file: ESRI ASCII grid (.asc), numpy array (.npy) or GeoTIFF (.tif)."""

    file: SceneFile
    """Path of the file, from the folder of the scene file."""
    cell_m: Positive | None = None
    """Edge of a cell of a .npy, whose rows run from north to south; other files say it themselves."""
    corner_m: Annotated[tuple[Place, Place], Field(strict=False)] | None = None
    """Easting and northing of the outer corner of the south-western cell of a .npy."""

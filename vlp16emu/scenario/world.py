"""The `[world]` table: a forest that grows itself, or a hall of known shapes."""

from typing import Annotated, Literal

from pydantic import Field

from vlp16emu.scenario.section import Fraction, NonNegative, Positive, Section

__all__ = ["Forest", "Hall", "HallBox", "HallPole", "HallSphere", "SpeciesShare", "Terrain", "World"]


class Terrain(Section):
    """Ground with relief: hills, plus roughness that a foot would feel."""

    hill_rms_m: NonNegative = 1.0
    """Standard deviation of height over wavelengths of 30 m to 300 m."""
    rough_rms_m: NonNegative = 0.06
    """Standard deviation of height over wavelengths of 1 m to 12 m."""
    slope_deg: Annotated[float, Field(ge=0, le=45)] = 0.0
    """Of the plane under it all, rising towards `slope_towards_deg`."""
    slope_towards_deg: Annotated[float, Field(ge=0, lt=360)] = 0.0
    """Counter-clockwise from east."""


class SpeciesShare(Section):
    """One species of the stand."""

    species: str
    """Name in the species table, for instance `silver_birch`."""
    share: Positive
    """Of stems; shares are scaled to sum to one."""
    dbh_cm: Annotated[float, Field(ge=5, le=120)]
    """Quadratic mean diameter at breast height."""
    height_m: Annotated[float, Field(ge=3, le=60)]
    """Height of the tree of that diameter."""


class Forest(Section):
    """A stand without edge on a terrain with relief."""

    kind: Literal["forest"]
    stems_per_ha: Annotated[float, Field(ge=0, le=5000)] = 600.0
    species: Annotated[list[SpeciesShare], Field(min_length=1)]
    path_clearance_m: NonNegative = 0.8
    """No stem surface comes nearer to the path than this."""
    terrain: Terrain = Terrain()


class HallBox(Section):
    """An upright box."""

    name: str
    centre_m: Annotated[tuple[float, float, float], Field(strict=False)]
    size_m: Annotated[tuple[Positive, Positive, Positive], Field(strict=False)]
    reflectance: Fraction = 0.5


class HallPole(Section):
    """An upright round pole."""

    name: str
    foot_m: Annotated[tuple[float, float, float], Field(strict=False)]
    diameter_m: Positive
    height_m: Positive
    reflectance: Fraction = 0.5


class HallSphere(Section):
    """A ball."""

    name: str
    centre_m: Annotated[tuple[float, float, float], Field(strict=False)]
    diameter_m: Positive
    reflectance: Fraction = 0.5


class Hall(Section):
    """A closed room of known size, centred on the origin, floor at z = 0, with things in it."""

    kind: Literal["hall"]
    length_m: Positive
    """Along x."""
    width_m: Positive
    """Along y."""
    height_m: Positive
    wall_reflectance: Fraction = 0.6
    boxes: list[HallBox] = Field(default_factory=list)
    poles: list[HallPole] = Field(default_factory=list)
    spheres: list[HallSphere] = Field(default_factory=list)


World = Annotated[Forest | Hall, Field(discriminator="kind")]

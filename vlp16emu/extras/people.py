"""People near the carrier: a companion who follows, and people who come towards the carrier and pass."""

from dataclasses import replace

import numpy as np

from vlp16emu.elementary import norm
from vlp16emu.motion.pose import Motion
from vlp16emu.random import Purpose, uniform
from vlp16emu.raycast.beam import LINE, Footprint
from vlp16emu.raycast.caster import Geometry
from vlp16emu.types import F4, F8, I8, SURFACE, Firings, HeightField, Hits, Semantic
from vlp16emu.units import seconds_to_ns
from vlp16emu.world.settings import People as PeopleSection

_FIRST_INSTANCE = 0xFFFFFFF0
"""Instance of the companion; people who pass have the next number. The user's objects have far smaller
numbers."""
_SHOULDERS = 0.82  # height of the shoulders, as a share of the stature (assumption)
_STATURE_M = 1.74
_WIDTH_M = 0.5
"""Height, and width of the shoulders with 0.04 m of outdoor clothing; medians of British men (City University
of Hong Kong, online anthropometry, chapter 2)."""
_PASSES_AT_M = 1.0  # lateral distance (assumption)
_REFLECTANCE = 0.5  # Lambertian, at 903 nm (assumption)
_HEAD_M = 0.0975
"""Radius of the head, half its length of 0.195 m (median British men; City University of Hong Kong, online
anthropometry)."""


class People:
    """People who walk on the carrier's path.

    They are at the carrier's position of another time, or behind the carrier.

    Parameters
    ----------
    section : table of the scene
    carrier : motion of the carrier
    height_m : height of the ground
    start_ns : UTC of the first pulse
    seed : determines when people pass, and on which side
    """

    def __init__(
        self, section: PeopleSection, carrier: Motion, height_m: HeightField, *, start_ns: int, seed: int
    ) -> None:
        self._section = section
        self._carrier = carrier
        self._height_m = height_m
        self._seed = seed
        self._start_ns = start_ns
        self._end_ns = start_ns + seconds_to_ns(carrier.run_time_s)
        self.surfaces = np.zeros(2, SURFACE)
        """(2,) rows of the table of surfaces, for the companion and for people who pass."""
        self.surfaces["reflectance"] = _REFLECTANCE
        self.surfaces["semantic"] = Semantic.OTHER
        self.surfaces["instance"] = _FIRST_INSTANCE + np.arange(2)

    def among(self, geometry: Geometry) -> "Peopled":
        """Return a window of the world with the people in it."""
        return Peopled(geometry, self)

    def in_front(self, firings: Firings, hits: Hits, first_surface: int) -> Hits:
        """Return hits in which a pulse that hits a person first ends there, with all its sub-rays.

        The companion's row is `first_surface`.
        """
        owner = np.repeat(np.arange(hits.count.size), hits.count.ravel())
        t_ns = firings.t_ns[:, 0]
        present = self._section.behind_m, self._section.passes_every_s
        for number, foot in enumerate((self._companion, self._passer)):
            if not present[number]:
                continue
            range_m, cosine = (of.reshape(-1)[owner] for of in self._hit_ranges(firings, foot(t_ns)))
            nearer = range_m < hits.range_m
            if nearer.any():
                hits = replace(
                    hits,
                    range_m=np.where(nearer, range_m, hits.range_m),
                    surface=np.where(nearer, np.uint32(first_surface + number), hits.surface),
                    cos_incidence=np.where(nearer, cosine, hits.cos_incidence),
                )
        return hits

    def _companion(self, t_ns: I8) -> F8:
        """Return the positions (k, 3) of the companion at instants (k,).

        The companion is on the ground, straight behind the carrier.
        """
        poses = self._carrier.poses_at(t_ns)
        behind_m = np.full(len(t_ns), -self._section.behind_m)
        return self._offset_on_ground(poses.world_p_body_m, poses.world_R_body[:, :2, 0], behind_m)

    def _passer(self, t_ns: I8) -> F8:
        """Return the positions (k, 3) of the person who passes.

        They are beside the carrier's position, mirrored in time about their meeting.
        """
        every_ns = seconds_to_ns(self._section.passes_every_s)
        periods, which = np.unique((t_ns - self._start_ns) // every_ns, return_inverse=True)
        when, side = np.array([uniform(self._seed, Purpose.PASSER, 2 * int(one), 2, 0) for one in periods])[
            which
        ].T
        meets_ns = (
            self._start_ns
            + every_ns * periods[which]
            + np.rint(every_ns * (0.25 + 0.5 * when)).astype(np.int64)
        )
        poses = self._carrier.poses_at(np.clip(2 * meets_ns - t_ns, self._start_ns, self._end_ns))
        aside_m = np.where(side < 0.5, -1.0, 1.0) * _PASSES_AT_M
        return self._offset_on_ground(poses.world_p_body_m, poses.world_R_body[:, :2, 1], aside_m)

    def _offset_on_ground(self, place_m: F8, axis: F8, by_m: F8) -> F8:
        """Return positions (k, 3) on the ground, at offsets `by_m` from positions (k, 3).

        The offsets are along horizontal axes (k, 2) of any length.
        """
        level_m = place_m[:, :2] + by_m[:, None] * axis / norm(axis)[:, None]
        return np.column_stack([level_m, self._height_m(level_m[:, 0].copy(), level_m[:, 1].copy())])

    def _hit_ranges(self, firings: Firings, foot_m: F8) -> tuple[F4, F4]:
        """Return ranges (k, L) at which pulses hit a person, inf for a miss, and cosines of incidence."""
        range_m = np.full(firings.t_ns.shape, np.inf)
        cosine = np.zeros(firings.t_ns.shape)
        from_foot_m = firings.origin_m - foot_m[:, None]
        at_m = _SHOULDERS * _STATURE_M
        for cylinder in ((_WIDTH_M / 2, 0.0, at_m), (_HEAD_M, at_m, _STATURE_M)):
            for found_m, slope in _cylinder(from_foot_m, firings.direction, *cylinder):
                nearer = found_m < range_m
                range_m = np.where(nearer, found_m, range_m)
                cosine = np.where(nearer, slope, cosine)
        return range_m.astype(np.float32), cosine.astype(np.float32)


def _cylinder(
    from_foot_m: F8, direction: F8, radius_m: float, low_m: float, high_m: float
) -> list[tuple[F8, F8]]:
    """Return range and cosine of incidence at the side and at the top of an upright cylinder.

    It is inf for a miss.
    """
    (x, y, z) = np.moveaxis(from_foot_m, -1, 0)
    (dx, dy, dz) = np.moveaxis(direction, -1, 0)
    level = dx * dx + dy * dy
    along = x * dx + y * dy
    outside = x * x + y * y - radius_m * radius_m
    square = along * along - level * outside
    with np.errstate(divide="ignore", invalid="ignore"):
        side_m = (-along - np.sqrt(np.maximum(square, 0.0))) / level
        at_m = z + side_m * dz
        top_m = (high_m - z) / dz
        slope = -((x + side_m * dx) * dx + (y + side_m * dy) * dy) / radius_m
        across = x + top_m * dx
        over = y + top_m * dy
        hits_side = (square > 0) & (side_m > 0) & (at_m >= low_m) & (at_m <= high_m)
        hits_top = (dz < 0) & (top_m > 0) & (across * across + over * over <= radius_m * radius_m)
    return [(np.where(hits_side, side_m, np.inf), slope), (np.where(hits_top, top_m, np.inf), -dz)]


class Peopled:
    """A window of the world with people in it; a `Geometry`."""

    def __init__(self, geometry: Geometry, people: People) -> None:
        self._geometry = geometry
        self._people = people
        self.surfaces = np.concatenate([geometry.surfaces, people.surfaces])
        """(m,) `SURFACE`, with the rows of people at its end."""

    @property
    def as_far(self) -> "Peopled":
        """The same window and people, with near content as the far medium too."""
        return Peopled(self._geometry.as_far, self._people)

    def cast(self, firings: Firings, near_m: F8, far_m: float, beam: Footprint = LINE) -> Hits:
        """Cast pulses in the window, and end pulses that hit people."""
        hits = self._geometry.cast(firings, near_m, far_m, beam)
        return self._people.in_front(firings, hits, len(self._geometry.surfaces))

"""Random rooms for `tools/unmask`, like the offices and halls of real captures.

A room has painted walls whose brightness varies smoothly, panes with frames, an opening into a second room,
furniture, shelves of books, posters, cables, black and white things, and plates that reflect back. Pipes,
cables and boards lean. The sensor stands on a table, as on real captures, among what is nearer than its least
range: things on the table, struts and people beside it.
"""

import json
from collections.abc import Iterable, Mapping

import numpy as np

Thing = dict[str, object]
Array = np.ndarray
SENSOR_M = 1.2
PANE = {"reflectance": 1e-5, "roughness": 0.05}
"""Finish of clean glass: it returns what falls on it straight, and nothing else."""
DUST = (1e-5, 1e-2)
"""Limits of the reflectance of panes; on real captures windows send single faint returns."""
BLACK = (0.0005, 0.04)
"""Limits of the reflectance of black things. Codes 1 to 5 are about equally frequent on real captures, and
next to what has no return codes of 1 and 2 are the most frequent."""
WHITE = (0.8, 0.95)
PRINTS = 9
"""Prints on a board are fewer: black or white patches, which real captures have in many rings."""
MOST_PAINT = (0.15, 0.35)
"""Limits of the roughness of paint and varnish."""

MOST_TEXTURE = 0.1
"""Greatest contrast of a small thing."""
MOST_OF_WALL = 0.03
"""The same of walls, whose brightness varies smoothly on real captures."""
BOOK_M = (0.02, 0.1)
"""Widths of books and folders on shelves. A fifth of the smooth stretches of 15 pulses of real units scatters
by 0.1 and more, through all rings: narrow things side by side have different brightness."""
TABLE_BELOW_M = (0.045, 0.12)
"""Limits of the height of the sensor's lens over the table: 38 mm over the foot of a VLP-16. On three real
captures the lasers from -7 or -5 degrees down have no return in 0.5 to 1 of the directions, and the next one
meets the table at 0.5 to 0.6 m."""
NEAR_M = (0.12, 0.45)
"""Limits of the distance of what hides a part of the view. Records without a return are 0.35, 0.47 and 0.50
of all on three real captures, mostly in sectors through all lasers, whose outlines lean or are round."""


class Room:
    """A room that is drawn from a seed; the sensor stands on the origin."""

    def __init__(self, seed: int) -> None:
        self.drawn = np.random.default_rng((seed, 60))
        length = 3.0 * 5.0 ** ((0.5 + 7 * seed % 10) / 10)
        width = max(length * self.drawn.uniform(0.5, 1.0), 2.6)
        self.half = np.array([length, width, self.drawn.uniform(2.3, 5.0)]) / 2.0
        self.paint = round(0.3 + 0.06 * (7 * seed % 10), 2)
        self.boxes: list[Thing] = []
        self.poles: list[Thing] = []
        for wall in self.drawn.permutation(4)[: self.drawn.integers(1, 4)]:
            self._windows(int(wall))
        self._hang(24)
        self._furnish(40)
        self._shelve(12)
        self._stand_up(18)
        self._partition()
        self._lean(16)
        self._polish(30)
        self._put_up()

    @property
    def settings(self) -> list[str]:
        """Settings of the scene `static_bench` that make it this room."""
        sizes = dict(zip(("length", "width", "height"), 2.0 * self.half, strict=True))
        return [
            *(f"world.{name}_m={size:.4f}" for name, size in sizes.items()),
            f"world.wall_reflectance={self.paint}",
            f"world.wall_roughness={self.drawn.uniform(*MOST_PAINT):.3f}",
            f"world.shading={self.drawn.uniform(0.03, 0.12):.3f}",
            f"world.texture={self.drawn.uniform(0.0, MOST_OF_WALL):.3f}",
            "world.relief_m=0.003",
            f"motion.height_m={SENSOR_M}",
            "world.spheres=[]",
            _setting("boxes", self.boxes),
            _setting("poles", self.poles),
        ]

    def _between(self, low: float, high: float) -> float:
        """Draw a number between two limits, uniform in its logarithm."""
        return float(low * (high / low) ** self.drawn.random())

    def _finish(self, rough_m: float = 0.0) -> Thing:
        """Draw a finish; a fifth of things are black, an eighth white, half have a coat, all a texture."""
        kind = self.drawn.random()
        grey = 0.03 * 30.0 ** self.drawn.random()
        reflectance = self._between(*BLACK) if kind < 0.2 else grey
        out: Thing = {
            "reflectance": round(float(self.drawn.uniform(*WHITE) if kind > 0.88 else reflectance), 4)
        }
        if self.drawn.random() < 0.5:
            out["roughness"] = round(float(self.drawn.uniform(*MOST_PAINT)), 3)
        texture = float(min(0.05 * np.exp(0.9 * self.drawn.standard_normal()), MOST_TEXTURE))
        out["texture"] = round(texture, 3)
        out["shading"] = round(float(self.drawn.uniform(0.0, 0.3)), 3)
        # What is rough casts shadows on itself: cloth, cartons, plants.
        out["relief_m"] = round(rough_m * texture / MOST_TEXTURE * self.drawn.random() / 2.0, 4)
        return out

    def _box(
        self, name: str, centre: Iterable[float], size: Iterable[float], finish: Mapping[str, object]
    ) -> None:
        """Add a box, as much of it as is inside; z counts from the floor."""
        middle = np.asarray(centre, float) - (0.0, 0.0, self.half[2])
        low, high = (
            np.clip(middle + sign * np.asarray(size) / 2, 0.001 - self.half, self.half - 0.001)
            for sign in (-1, 1)
        )
        if (high - low).min() < 0.002:
            return
        at = (low + high) / 2 + (0.0, 0.0, self.half[2])
        self.boxes.append(
            {
                "name": f"{name} {len(self.boxes)}",
                "centre_m": at.round(4).tolist(),
                "size_m": (high - low).round(4).tolist(),
                **finish,
            }
        )

    def _on_wall(
        self, wall: int, along: float, up: float, size: tuple[float, float, float]
    ) -> tuple[Array, Array]:
        """Return centre and size of a box on a wall; size along the wall, upwards and away from it."""
        axis, sign = wall // 2, 1 - 2 * (wall % 2)
        centre, extent = np.zeros(3), np.zeros(3)
        centre[axis], extent[axis] = sign * (self.half[axis] - size[2] / 2), size[2]
        centre[1 - axis], extent[1 - axis] = along, size[0]
        centre[2], extent[2] = up, size[1]
        return centre, extent

    def _windows(self, wall: int) -> None:
        """Add panes side by side on a wall, with a frame around each and a radiator below."""
        reach = float(self.half[1 - wall // 2])
        count, wide = int(self.drawn.integers(1, 4)), self.drawn.uniform(0.2, 0.55) * reach
        start = self.drawn.uniform(-reach + 0.1, max(reach - count * wide - 0.1, -reach + 0.2))
        sill, tall = self.drawn.uniform(0.7, 1.1), self.drawn.uniform(0.9, 1.8)
        frame = self._finish()
        glass = {**PANE, "reflectance": round(self._between(*DUST), 6), "shading": 0.3, "texture": 0.1}
        for i in range(count):
            middle = start + (i + 0.5) * wide
            self._box("pane", *self._on_wall(wall, middle, sill + tall / 2, (wide, tall, 0.02)), glass)
            for edge in (middle - wide / 2, middle + wide / 2):
                self._box("frame", *self._on_wall(wall, edge, sill + tall / 2, (0.07, tall, 0.07)), frame)
        self._box(
            "sill", *self._on_wall(wall, start + count * wide / 2, sill, (count * wide, 0.05, 0.2)), frame
        )
        self._box(
            "radiator",
            *self._on_wall(wall, start + count * wide / 2, 0.45, (count * wide, 0.5, 0.12)),
            self._finish(),
        )

    def _hang(self, count: int) -> None:
        """Add posters, boards and plates on walls, and a frame around each third of them."""
        for i in range(count):
            wall = int(self.drawn.integers(4))
            reach = float(self.half[1 - wall // 2])
            wide, tall = 0.15 * 8.0 ** self.drawn.random(2)
            along, up = self.drawn.uniform(-reach, reach), self.drawn.uniform(0.6, 2.0)
            if i % 3 == 0:
                outer = self._on_wall(wall, along, up, (wide + 0.08, tall + 0.08, 0.015))
                self._box("frame", *outer, self._finish())
            plate = {"retroreflection_cd_lx_m2": round(float(4.0 * 20.0 ** self.drawn.random()), 1)}
            size = (0.4, 0.12, 0.02) if i == 0 else (float(wide), float(tall), 0.02)
            self._box("board", *self._on_wall(wall, along, up, size), plate if i == 0 else self._finish())
            for _ in range(self.drawn.integers(PRINTS) if i > 0 else 0):
                left, top = self.drawn.uniform(-0.4, 0.4, 2) * size[:2]
                part = self.drawn.uniform(0.1, 0.5, 2) * size[:2]
                limits = BLACK if self.drawn.random() < 0.6 else WHITE
                ink = {"reflectance": round(self._between(*limits), 4)}
                patch = self._on_wall(wall, along + left, up + top, (float(part[0]), float(part[1]), 0.024))
                self._box("print", *patch, ink)

    def _shelve(self, count: int) -> None:
        """Add shelves on walls: rows of books and folders side by side, each of one brightness."""
        for _ in range(count):
            wall = int(self.drawn.integers(4))
            reach = float(self.half[1 - wall // 2])
            start, stop = np.sort(self.drawn.uniform(-reach, reach, 2))
            low, tall = self.drawn.uniform(0.3, 1.6), self.drawn.uniform(0.25, 0.6)
            deep = self.drawn.uniform(0.15, 0.3)
            stop = min(stop, start + 2.0)
            while start < stop:
                wide = self.drawn.uniform(*BOOK_M)
                book = {"reflectance": round(float(0.08 * 11.0 ** self.drawn.random()), 3)}
                size = (float(wide), float(tall), float(deep - 0.01 * self.drawn.random()))
                self._box("book", *self._on_wall(wall, start + wide / 2, low + tall / 2, size), book)
                start += wide

    def _furnish(self, count: int) -> None:
        """Add tables, shelves, crates and cupboards, each at least 0.6 m away from the sensor."""
        while count:
            size = 0.08 * 18.0 ** self.drawn.random(3)
            centre = np.append(self.drawn.uniform(-1.0, 1.0, 2) * self.half[:2], self.drawn.uniform(0.2, 2.0))
            if self.drawn.random() < 0.6:
                side = int(self.drawn.integers(2))
                centre[side] = np.copysign(self.half[side] - size[side] / 2, centre[side])
            if self.drawn.random() < 0.5:
                centre[2] = size[2] / 2
            if np.hypot(*np.maximum(np.abs(centre) - size / 2, 0.0)[:2]) > 0.6:
                self._box("thing", centre, size, self._finish(0.03))
                count -= 1

    def _stand_up(self, count: int) -> None:
        """Add cables, pipes, legs and columns."""
        while count:
            x, y = self.drawn.uniform(-1.0, 1.0, 2) * (self.half[:2] - 0.2)
            if np.hypot(x, y) > 0.9:
                tall = min(self.drawn.uniform(0.8, 4.0), 2.0 * self.half[2] - 0.01)
                size = {
                    "diameter_m": round(float(0.015 * 20.0 ** self.drawn.random()), 3),
                    "height_m": round(float(tall), 3),
                }
                self.poles.append(
                    {
                        "name": f"pole {count}",
                        "foot_m": [round(float(x), 3), round(float(y), 3), 0.0],
                        **size,
                        **self._finish(0.005),
                    }
                )
                count -= 1

    def _tilted_box(
        self, name: str, centre: Iterable[float], size: Iterable[float], finish: Thing, **angles_deg: float
    ) -> None:
        """Add a box in any attitude, if it is inside; z counts from the floor."""
        middle, extent = np.asarray(centre, float), np.asarray(size, float)
        reach = np.sqrt((extent * extent).sum()) / 2
        low, high = middle - reach, middle + reach - (0.0, 0.0, 2 * self.half[2])
        if low[2] < 0.0 or high[2] > 0.0 or (np.maximum(-low, high)[:2] > self.half[:2]).any():
            return
        self.boxes.append(
            {
                "name": f"{name} {len(self.boxes)}",
                "centre_m": middle.round(4).tolist(),
                "size_m": extent.round(4).tolist(),
                **{key: round(float(value), 1) for key, value in angles_deg.items()},
                **finish,
            }
        )

    def _strut(self, name: str, ends: Array, diameter_m: float) -> None:
        """Add a pole from one end to another (2, 3), if it is inside; z counts from the floor."""
        along = ends[1] - ends[0]
        long_m = float(np.sqrt((along * along).sum()))
        low, high = ends.min(axis=0) - diameter_m, ends.max(axis=0) + diameter_m
        if low[2] < 0.0 or high[2] > 2 * self.half[2] or (np.maximum(-low, high)[:2] > self.half[:2]).any():
            return
        self.poles.append(
            {
                "name": f"{name} {len(self.poles)}",
                "foot_m": ends[0].round(4).tolist(),
                "diameter_m": round(diameter_m, 4),
                "height_m": round(long_m, 4),
                "yaw_deg": round(float(np.degrees(np.arctan2(along[1], along[0]))), 2),
                "pitch_deg": round(float(np.degrees(np.arccos(along[2] / long_m))), 2),
                **self._finish(0.005),
            }
        )

    def _lean(self, count: int) -> None:
        """Add pipes and cables that lean or hang, and turned crates and boards, 0.8 m away and farther."""
        for i in range(count):
            x, y = self.drawn.uniform(-1.0, 1.0, 2) * (self.half[:2] - 0.3)
            if np.hypot(x, y) < 0.8:
                continue
            if i % 2:
                foot = np.array([x, y, self.drawn.uniform(0.1, 1.8)])
                over = foot + self.drawn.uniform(-1.0, 1.0, 3) * (1.0, 1.0, 1.2)
                if np.hypot(*over[:2]) > 0.8:
                    self._strut("pipe", np.array([foot, over]), self._between(0.012, 0.12))
            else:
                size = 0.04 * 25.0 ** self.drawn.random(3)
                angles = {"yaw_deg": self.drawn.uniform(-180.0, 180.0)}
                if i % 4:
                    angles["pitch_deg"] = self.drawn.uniform(-60.0, 60.0)
                height = self.drawn.uniform(0.6, 1.8)
                self._tilted_box("crate", (x, y, height), size, self._finish(0.02), **angles)

    def _polish(self, count: int) -> None:
        """Add polished things in any attitude, 0.6 m away and farther: screens, glasses, metal, lacquer.

        Runs of 4 to 30 records without a return, between dark returns, are 55 to 180 in a turn of real units.
        """
        for _ in range(count):
            x, y = self.drawn.uniform(-1.0, 1.0, 2) * self.half[:2] * 0.95
            size = 0.06 * 8.0 ** self.drawn.random(3)
            if np.hypot(x, y) > 0.6 + size.max():
                angles = dict(zip(("yaw_deg", "pitch_deg"), self.drawn.uniform(-90.0, 90.0, 2), strict=True))
                finish = {**PANE, "reflectance": round(self._between(*DUST), 6)}
                place = (x, y, SENSOR_M + self.drawn.uniform(-0.25, 0.25) * np.hypot(x, y))
                self._tilted_box("polished thing", place, size, finish, **angles)

    def _put_up(self) -> None:
        """Stand the sensor on a table, with things on it, and struts and people beside it."""
        top = SENSOR_M - self._between(*TABLE_BELOW_M)
        size = np.array([self.drawn.uniform(0.5, 1.8), self.drawn.uniform(0.4, 0.9)])
        middle = self.drawn.uniform(-0.5, 0.5, 2) * (size - 0.25)
        yaw = self.drawn.uniform(-180.0, 180.0)
        c, s = np.cos(np.radians(yaw)), np.sin(np.radians(yaw))
        centre = np.array([c * middle[0] - s * middle[1], s * middle[0] + c * middle[1]])
        self._tilted_box("table", (*centre, top - 0.02), (*size, 0.04), self._finish(0.01), yaw_deg=yaw)
        for _ in range(self.drawn.integers(4, 12)):
            far, at = self._between(0.12, 0.9), self.drawn.uniform(0.0, 2 * np.pi)
            wide, deep, tall = 0.02 * 12.0 ** self.drawn.random(3)
            tilt = self.drawn.uniform(-40.0, 40.0) if self.drawn.random() < 0.4 else 0.0
            if far > 0.06 + np.hypot(wide, deep) / 2:
                place = (far * np.cos(at), far * np.sin(at), top + tall / 2)
                turned = {"yaw_deg": self.drawn.uniform(-180.0, 180.0), "pitch_deg": tilt}
                self._tilted_box("thing", place, (wide, deep, tall), self._finish(0.01), **turned)
        for _ in range(self.drawn.integers(2, 8)):
            far, at = self._between(*NEAR_M), self.drawn.uniform(0.0, 2 * np.pi)
            foot = np.array([far * np.cos(at), far * np.sin(at), top])
            over = foot + self.drawn.uniform(-0.15, 0.15, 3) + (0.0, 0.0, self.drawn.uniform(0.1, 0.6))
            if np.hypot(*over[:2]) > NEAR_M[0]:
                self._strut("strut", np.array([foot, over]), self._between(0.006, 0.05))
        for _ in range(self.drawn.integers(0, 3)):
            self._person()

    def _person(self) -> None:
        """Add a person who stands at the table: a body that leans, arms and a head."""
        at, wide = self.drawn.uniform(0.0, 2 * np.pi), self.drawn.uniform(0.3, 0.44)
        away = np.array([np.cos(at), np.sin(at), 0.0])
        aside = np.array([-away[1], away[0], 0.0])
        hip = away * (wide / 2 + self._between(0.15, 0.6)) + (0.0, 0.0, 0.85)
        neck = hip + away * self.drawn.uniform(-0.1, 0.15) + (0.0, 0.0, self.drawn.uniform(0.35, 0.6))
        self._strut("body", np.array([hip, neck]), float(wide))
        top = neck + np.array([0.0, 0.0, 0.28])
        self._strut("head", np.array([neck, top]), 0.2)
        for side in (-1.0, 1.0):
            shoulder = neck + side * aside * wide / 2 - (0.0, 0.0, 0.05)
            hand = (
                shoulder + side * aside * self.drawn.uniform(-0.1, 0.3) - away * self.drawn.uniform(0.0, 0.3)
            )
            hand[2] -= self.drawn.uniform(0.1, 0.45)
            if np.hypot(*hand[:2]) > NEAR_M[0]:
                self._strut("arm", np.array([shoulder, hand]), 0.09)

    def _partition(self) -> None:
        """Add a wall with an opening, and extend the hall behind it by up to 20 m."""
        at, (_, wide, tall) = float(self.half[0]), self.half
        self.half[0] += self.drawn.uniform(1.0, 10.0)
        finish = {**self._finish(), "reflectance": self.paint, "relief_m": 0.003, "texture": MOST_OF_WALL}
        left, right = sorted(self.drawn.uniform(-0.8, 0.8, 2) * wide)
        for side, other in ((-wide, left), (right, wide)):
            self._box("partition", (at, (side + other) / 2, tall), (0.1, other - side, 2 * tall), finish)
        self._box("parapet", (at, (left + right) / 2, 0.4), (0.1, right - left, 0.8), finish)


def _setting(kind: str, things: Iterable[Thing]) -> str:
    """Return the setting of a list of things, in TOML."""
    rows = (", ".join(f"{key} = {json.dumps(value)}" for key, value in one.items()) for one in things)
    return f"world.{kind}=[{', '.join(f'{{{row}}}' for row in rows)}]"

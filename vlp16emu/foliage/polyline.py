"""Distance in the plane from points to a path."""

import numpy as np

from vlp16emu.elementary import hypot
from vlp16emu.kernels.compiler import array_kernel
from vlp16emu.types import F8

_PIECE = 32  # segments that share a bounding box
_SLACK_M = 1e-6  # boxes this much farther than the nearest segment are still searched, to allow for rounding


class Polyline:
    """A line (m, 2), m >= 1, in the plane, with fast distance queries."""

    def __init__(self, xy_m: F8) -> None:
        self.xy_m = np.ascontiguousarray(xy_m, np.float64)
        starts = range(0, max(len(xy_m) - 1, 1), _PIECE)
        pieces = [self.xy_m[i : i + _PIECE + 1] for i in starts]
        # (pieces, 4): minimum x and y, maximum x and y.
        self._boxes = np.array([[*piece.min(axis=0), *piece.max(axis=0)] for piece in pieces])

    def distance_m(self, points_xy_m: F8) -> F8:
        """Distance (n,) from each point (n, 2); the same bits for the reversed line."""
        out = np.empty(len(points_xy_m))
        _distances(out, np.ascontiguousarray(points_xy_m), self.xy_m, self._boxes)
        return out


class Corridor(Polyline):
    """The path of the sensor, and the distance that plants and things keep from it."""

    def __init__(self, xy_m: F8, clearance_m: float) -> None:
        super().__init__(xy_m)
        self.clearance_m = clearance_m


def distance_m(points_xy_m: F8, line_xy_m: F8) -> F8:
    """Distance (n,) from each point (n, 2) to a polyline (m, 2), m >= 1, for a single query."""
    return Polyline(line_xy_m).distance_m(points_xy_m)


@array_kernel
def _distances(out: F8, points: F8, line: F8, boxes: F8) -> None:
    """Fill (n,) distances: first the piece with the nearest box, then all pieces that could be nearer."""
    gap = np.empty(boxes.shape[0])
    for i in range(out.shape[0]):
        x, y = points[i, 0], points[i, 1]
        first = 0
        for k in range(boxes.shape[0]):
            dx = max(boxes[k, 0] - x, x - boxes[k, 2], 0.0)
            dy = max(boxes[k, 1] - y, y - boxes[k, 3], 0.0)
            gap[k] = hypot(dx, dy)
            if gap[k] < gap[first]:
                first = k
        nearest = _to_piece(x, y, line, first)
        for k in range(boxes.shape[0]):
            if gap[k] < nearest + _SLACK_M:
                nearest = min(nearest, _to_piece(x, y, line, k))
        out[i] = nearest


@array_kernel
def _to_piece(x: float, y: float, line: F8, piece: int) -> float:
    """Distance of a point from the segments of one piece."""
    last = line.shape[0] - 1
    nearest = np.inf
    for j in range(piece * _PIECE, min(piece * _PIECE + _PIECE, max(last, 1))):
        ax, ay = line[j, 0], line[j, 1]
        bx, by = line[min(j + 1, last), 0], line[min(j + 1, last), 1]
        if (bx, by) < (ax, ay):  # same order, so same bits, for both walking directions
            ax, ay, bx, by = bx, by, ax, ay
        ux = bx - ax
        uy = by - ay
        px = x - ax
        py = y - ay
        length2 = ux * ux + uy * uy
        along = min(max((px * ux + py * uy) / length2, 0.0), 1.0) if length2 > 0 else 0.0
        nearest = min(nearest, hypot(px - along * ux, py - along * uy))
    return nearest

"""Voxels of a medium: their size, and the codes of their projected area."""

import numpy as np

VOXEL_M = 0.5
BRICK = 4  # voxels along the edge of a brick
COLUMNS = 40  # voxels along the edge of a tile of 20 m
LEAVES = 16  # leaves along the edge of a voxel, side by side

FINER = 2  # squares of the ground along the edge of a voxel

KNOTS = np.array([0.0, 0.3, 1.0])
"""Sines of the elevations (knots) at which projected areas are stored: level, 17 degrees, and vertical."""
QUANTILES = 16  # quantiles of the cosine of incidence, at the midpoints of equal shares of projected area

CODES = 127  # greatest code, and its projected area per volume
MOST_PER_M = 24.0
TAU_PER_M = (MOST_PER_M * np.square(np.arange(CODES + 1) / CODES)).astype(np.float32)
"""Projected area per volume for each code."""

LAW_BIT = np.uint64(32)
TILE_BIT = np.uint64(52)
SHARE_BIT = np.uint64(56)
"""First bits of the parts of an owner; its row begins at bit 0."""
LAW_MASK = np.uint64((1 << 20) - 1)

GROUND = np.uint32(1 << 21)
"""Flag of a voxel, above its three codes of seven bits: ground may be met in or beside it."""

LOW, CROWN, LEVEL, TUFTS = range(4)
"""Kinds of foliage in a voxel: of low plants, of crowns, of leaves that lie nearly level, and of leaves in
tufts of some 100 mm that hide nearly all behind them."""
KIND_BIT = np.uint32(22)  # first of two bits of the kind

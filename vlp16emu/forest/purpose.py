"""Purposes of the random numbers of a forest."""

from enum import IntEnum


class Growth(IntEnum):
    """Purposes in addition to `vlp16emu.random.Purpose`, with other values; never renumber, only append."""

    TERRAIN = 2
    STAND = 3
    TREE = 4
    CROWN = 5
    DEAD_BRANCH = 20
    SHRUB = 21
    SECOND_STOREY = 30
    THIRD_STOREY = 31
    REGENERATION = 32
    SHRUBS = 33
    STONES = 34
    LOGS = 35
    STUMPS = 36
    GRASS = 37
    SAPLING = 38
    FLOOR_SHAPE = 39
    MOUND = 40
    GIVEN_TREE = 41
    STEM_FORM = 42
    WIND = 71
    HERBS = 111
    FERNS = 112
    DWARF_SHRUBS = 113
    MOSS = 114
    LITTER = 115
    PIT = 117
    IVY = 118
    RUT = 119
    ROOT = 120

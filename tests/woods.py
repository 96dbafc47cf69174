"""The wood that tests look at: few and near birches on hills without roughness, which grow in seconds,
once for all tests of a session that keep woods."""

from kit import set_words

THIN = {"seed": 5, "world.stems_per_ha": 150, "sensor.max_range_m": 15.0, "world.terrain.rough_rms_m": 0.0}
LINES = tuple(f"{key}={value}" for key, value in THIN.items())  # the same as settings of a command line
WORDS = set_words(LINES)

"""Surroundings of the sensor: the contract of worlds, and a hall of known shapes."""

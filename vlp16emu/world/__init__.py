"""Surroundings of the sensor: the interface of worlds, and a hall of known shapes."""

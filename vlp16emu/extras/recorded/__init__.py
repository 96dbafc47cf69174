"""Recorded poses: a motion among others, and the trajectories that other extras read."""

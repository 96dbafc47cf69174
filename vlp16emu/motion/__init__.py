"""Motions of the carrier at any time, and devices on it."""

"""Runs of an engine: recordings and streams over UDP."""

"""Runs of an engine: into a capture, over UDP, and again from a capture."""

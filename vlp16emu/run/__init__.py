"""Runs of an engine: into a capture, and over UDP."""

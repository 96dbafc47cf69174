"""Poses that arrive while a run is streamed."""

"""Test bench around the sensor: wiring, settings, events and the web interface."""

"""What stands around a sensor on a bench: its web interface, events on the wire, lines to GPS and IMU."""

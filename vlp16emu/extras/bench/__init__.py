"""What is wired to the sensor, set on it or done to it, and its web interface."""

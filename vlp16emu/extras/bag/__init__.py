"""Captures and runs as bags of ROS 1 and ROS 2."""

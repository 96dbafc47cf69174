"""Captures and runs as bags of ROS 1 and ROS 2."""

from vlp16emu.extras.bag.write import bag_of_run, write_bag

__all__ = ["bag_of_run", "write_bag"]

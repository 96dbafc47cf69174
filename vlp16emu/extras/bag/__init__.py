"""Captures and runs as bags of ROS 1 and ROS 2."""

from vlp16emu.extras.bag.capture import BagResult, write_bag
from vlp16emu.extras.bag.run import bag_of_run
from vlp16emu.extras.bag.sink import BagSink

__all__ = ["BagResult", "BagSink", "bag_of_run", "write_bag"]

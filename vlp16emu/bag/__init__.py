"""Captures and runs as bags of ROS 1 and ROS 2."""

from vlp16emu.bag.capture import BagResult, write_bag
from vlp16emu.bag.run import bag_of_run
from vlp16emu.bag.sink import BagSink

__all__ = ["BagResult", "BagSink", "bag_of_run", "write_bag"]

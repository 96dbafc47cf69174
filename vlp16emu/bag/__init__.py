"""Captures and runs as bags of ROS 1 and ROS 2."""

from vlp16emu.bag.of_capture import BagResult, write_bag
from vlp16emu.bag.recorded import record_bag

__all__ = ["BagResult", "record_bag", "write_bag"]

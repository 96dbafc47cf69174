"""Hardware-in-the-loop emulator of the Velodyne VLP-16 lidar."""

from vlp16emu.compiled import keep_compiled

__all__: list[str] = []

keep_compiled()

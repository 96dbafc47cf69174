"""Hardware-in-the-loop emulator of the Velodyne VLP-16 lidar."""

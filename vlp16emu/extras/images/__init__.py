"""What a camera at the place of the sensor would see: depth, labels and colours."""

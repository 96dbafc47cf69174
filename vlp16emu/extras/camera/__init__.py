"""A camera on the sensor's carrier: images of colour, depth and labels."""

"""A person who walks with the sensor on the back."""

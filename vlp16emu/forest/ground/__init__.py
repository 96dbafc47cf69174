"""The ground: generated relief, or heights from a file."""

"""The ground: with relief of its own, or with heights from a file."""

"""What stands in a world: in figures, on a plan, and in a section from the side."""

"""Positions and labels of plants and things, and the sway of trees in the wind."""

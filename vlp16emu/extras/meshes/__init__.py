"""Meshes of the user's own, as things in the world and as trees."""

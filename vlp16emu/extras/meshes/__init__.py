"""The user's own meshes, as objects in the world and as trees."""

"""What the user brings: measured trees, and meshes."""

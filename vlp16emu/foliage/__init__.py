"""What is far, as a medium of voxels: a caster beside Embree."""

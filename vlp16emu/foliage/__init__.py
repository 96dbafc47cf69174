"""Far vegetation as a medium of voxels: a caster beside Embree."""

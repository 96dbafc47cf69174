"""Far vegetation as a medium of voxels, cast beside Embree."""

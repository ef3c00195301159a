"""Values that everything else is said in: arrays, rigid transforms, cameras, meshes. NumPy and SciPy only."""

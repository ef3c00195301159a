"""Sessions, images, cameras, meshes and results on disk."""

"""Basic values: arrays, rigid transforms, lenses, cameras, meshes.

NumPy and SciPy only, but for the kernels.
"""

"""Read and write cameras: our own format and those of other programs."""

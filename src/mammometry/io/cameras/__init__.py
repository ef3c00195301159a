"""Read and write cameras, in our own format and in those of other programs."""

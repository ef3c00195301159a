"""What everybody speaks of: errors, progress, photographs, cores, compiled kernels, memory."""

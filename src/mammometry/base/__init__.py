"""Foundations of all packages: errors, progress, photographs, cores, compiled kernels, memory."""

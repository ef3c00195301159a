"""This machine: its cores, its memory, compiled kernels."""

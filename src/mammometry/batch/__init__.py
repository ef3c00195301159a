"""Many sessions on many machines: each one a task of Dask, in a process of its own."""

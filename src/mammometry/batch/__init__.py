"""Many sessions on many machines: one Dask task and one process each."""

"""Independent tasks in their own processes, on this machine or on a Dask cluster; a crash affects one task only."""

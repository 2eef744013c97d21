"""Campaigns on a Dask cluster: one more pool of workers behind the seam of :mod:`.worker_pool`."""

"""Runs on a Dask cluster: what we do, and what its workers do."""

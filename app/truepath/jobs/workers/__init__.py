"""Processes that compute, here or by Dask, and what they are given to compute."""

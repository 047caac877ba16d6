"""Rows read and written: jobs, events, requests that are repeated."""

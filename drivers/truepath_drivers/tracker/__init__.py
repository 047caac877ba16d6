"""Trackers, one folder a make."""

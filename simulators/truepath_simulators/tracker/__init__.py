"""Laser trackers in each protocol that the drivers know."""

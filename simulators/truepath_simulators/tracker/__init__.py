"""Laser trackers in each protocol that the drivers know.

Not here: where the target truly is (`machine`), faults of the line (`links`).
"""

"""Laser trackers in each protocol that the drivers know.

Not here: the true position of the target (`machine`), faults of the line (`links`).
"""

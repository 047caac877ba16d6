"""Whole measurements without devices: bundles and recordings with known truth.

Not here: devices that take part in a measurement (`bench`).
"""

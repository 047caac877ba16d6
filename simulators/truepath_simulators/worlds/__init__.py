"""Whole measurements without devices: bundles and recordings with known truth."""

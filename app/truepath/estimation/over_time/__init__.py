"""Drift of the machine and growth with temperature."""

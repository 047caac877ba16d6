"""Observations to an estimate."""

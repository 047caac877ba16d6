"""The tracker's stream: cleaned, standstills found, matched to the commanded rows.

Here: decisions sample by sample, and exclusions with their causes. Not here:
observations made of the samples (`alignment.observations`); the stream of a live
tracker (`measurement.monitors`).
"""

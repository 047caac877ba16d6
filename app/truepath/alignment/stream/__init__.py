"""The tracker's stream: cleaned, standstills found, matched to the rows commanded.

Here: what is decided sample by sample, and what is left out and why. Not here:
observations made of the samples (`alignment.observations`); the stream of a live
tracker (`measurement.monitors`).
"""

"""Thermometers and sensors of the air, one folder per kind of link.

Not here: plausibility of readings, which the service checks.
"""

"""Air and material during a measurement, and the refraction of light.

Here: `environment.csv` and what follows for ranges. Not here: live sensors
(`measurement.monitors`).
"""

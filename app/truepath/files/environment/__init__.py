"""Air and material during a measurement, and the refraction of light.

Here: `environment.csv` and its effect on ranges. Not here: live sensors
(`measurement.monitors`).
"""

"""The measurement: steps along a path or from point to point.

Here: commands to controller and tracker, holds, the end. Not here: checks during motion
(`measurement.monitors`), the process (`measurement.process`).
"""

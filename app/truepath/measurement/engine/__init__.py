"""The measurement itself: steps along a path or from point to point.

Here: commands to controller and tracker, holds, the end. Not here: what is checked
meanwhile (`measurement.monitors`), the process (`measurement.process`).
"""

"""What is checked while a machine moves: stream, controller, feed hold, sensors.

Here: one source of faults a file. Not here: what a measurement does about them
(`measurement.engine`), how samples are decoded (`truepath_drivers`).
"""

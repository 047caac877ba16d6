"""Checks during motion: stream, controller, feed hold, sensors.

Here: one source of faults per file. Not here: the reaction of a measurement
(`measurement.engine`), decoding of samples (`truepath_drivers`).
"""

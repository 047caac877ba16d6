"""Errors from Run to Run, and the forecast of the next calibration.

Here: figures, forecast and report. Not here: the states over time themselves
(`estimation.solve`).
"""

"""A machine's errors over temperature, from several calibrations.

Here: the fit over results, its file and report. Not here: growth within one Run
(`kinematics.effects`), drift in time (`answers.trend`).
"""

"""Size and correlation time of the errors of observations.

Here: noise fitted together with the error motions. Not here: the noise model
(`estimation.problem.noise`), its algebra (`numerics`), samples within cells
(`estimation.checks`).
"""

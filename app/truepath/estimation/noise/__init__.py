"""Size and correlation time of the errors of observations.

Here: noise fitted from residuals and from samples within cells. Not here: the noise
model (`estimation.problem.noise`), its algebra (`numerics`).
"""

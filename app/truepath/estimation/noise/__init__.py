"""How large the errors of observations are, and how long they last.

Here: noise fitted from residuals and from samples within cells. Not here: the noise
model itself (`estimation.problem.noise`), its algebra (`numerics`).
"""

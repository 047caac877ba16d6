"""The linear problem: design matrix, information, prior, knots, observability.

Here: unknowns, data, and what these do not determine. Not here: the solution
(`estimation.solve`), partial derivatives of effects (`kinematics`).
"""

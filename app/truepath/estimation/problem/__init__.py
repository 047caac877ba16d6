"""The linear problem: design matrix, information, prior, knots, observability.

Here: what is estimated from what, and what cannot be. Not here: its solution
(`estimation.solve`), partial derivatives of effects (`kinematics`).
"""

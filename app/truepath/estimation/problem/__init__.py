"""The linear problem: design matrix, information, prior, knots, what is observable."""

"""Mathematics independent of machines: pure functions of arrays.

Not here: whatever knows an axis, a tracker or a Run.

Errors of samples are white plus an Ornstein–Uhlenbeck process (`correlated_noise`): the
inverse covariance is then banded, so generalised least squares costs time linear in the
number of points, for all points at once or a few at a time (Rue & Held, Gaussian Markov
Random Fields, 2005). Parameters that few points share are eliminated on the way by a
Schur complement. Positive definite matrices of unlike units are scaled to a unit
diagonal before they are factorised (`scaled_cholesky`; van der Sluis 1969).

The value of one more measurement is the reduction of the integrated variance tr(G C)
(`design_criteria`; eq. 34–36): along an axis it is a ratio of polynomials, whose
maximum is found exactly as a root (eq. 27).

Rigid motions are a rotation and a translation (`rigid`; Rodrigues' formula). Monte
Carlo trials continue until their mean, standard deviation and interval are stable
(`adaptive_trials`; GUM Supplement 1, 7.9).
"""

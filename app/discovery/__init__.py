"""What the model still lacks: where it errs, which effect it is, how much that closes.

A Run is held against the rigid-body model fitted to it, or against a given model. The
error motions of that base are elastic: whatever a smooth error motion can absorb is no
evidence for anything else. The noise is judged beside splines of time, so that what is
slow is left to be explained and does not pass for noise.

Families of effects (`kinematics/effects/`, found by entry point) propose candidates,
linear in their parameters; leads, time constants and moments are scanned, then refined
by their own column. Effects enter one by one on their Bayes factor less the price of
the search, and only where lines that the fit did not see are foretold better; they are
tried again for exchange and removal. No effect is an answer, and so is structure that
is described without a cause (waves in time or along an axis, errors of two axes).

Several Runs are explained together, each with a pose, a timing and a noise of its own.
Where names compete, lines are planned by the log Bayes factor that they are expected to
bring a second (Lindley 1956, Box & Hill 1967), and the Runs decide together.

brunn-hanebeck-2005 leaves non-rigid behaviour, sanders-2023 what its residuals hold, to
future work.
"""

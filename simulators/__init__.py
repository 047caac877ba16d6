"""The device end of the wire: a truth machine, a tracker, a CNC and their faults.

Written independently of the service (exact homogeneous transforms), so that a bench
cannot confirm the estimator's own mistakes.
"""

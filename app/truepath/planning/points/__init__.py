"""The best standstill point to measure next.

Not here: points without a plan (`motion.paths`).
"""

"""The truth machine: joints with error motions, composed exactly.

Here also: random machines, and the tracker's head. Not here: effects outside of a
rigid-body model (`hidden`).
"""

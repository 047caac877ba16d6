"""The reflector: found, and found again after the beam was lost.

Not here: the targets of a plan (`planning`), their offsets (`estimation`).
"""

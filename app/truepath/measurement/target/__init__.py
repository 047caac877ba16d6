"""The reflector: found, and found again after the beam was lost.

Not here: which targets a plan has (`planning`), where they sit (`estimation`).
"""

"""The bench: simulated devices started together, controlled by a command or a test.

Not here: the devices themselves (`tracker`, `cnc`).
"""

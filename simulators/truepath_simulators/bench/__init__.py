"""The bench: simulated devices started together, steered by a command or a test.

Not here: the devices themselves (`tracker`, `cnc`).
"""

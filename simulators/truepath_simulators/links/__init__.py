"""Serial, TCP and UDP ends of the wire, and damage to their bytes.

Not here: protocols, which are with the device that speaks them.
"""

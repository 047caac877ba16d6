"""Serial, TCP and UDP ends of the wire, and what damages what passes through them.

Not here: protocols, which are with the device that speaks them.
"""

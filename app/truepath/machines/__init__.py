"""A machine's measuring process as the service sees it: supervised, asked, connected.

The process itself is `measurement.process`.
"""

"""Bridge kit: GST/1 for a program beside a maker's SDK.

Each file is self-contained and may be copied; see docs/bridge.md.
gst_bridge.h    the device's side of GST/1 in C99, without memory of its own
gst_bridge.py   the same in Python, nothing but the standard library
example.c       a TCP server with the header; the place of the SDK is marked
"""

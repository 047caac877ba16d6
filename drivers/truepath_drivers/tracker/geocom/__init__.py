"""Leica instruments that speak GeoCOM in ASCII, over serial or TCP.

After public clients, geocompy (MIT) and DMPACK (ISC), and the reference manuals they
cite. Not tested with a real instrument.
"""

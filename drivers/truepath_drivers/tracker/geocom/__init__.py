"""Leica instruments that speak GeoCOM in ASCII, over serial or TCP.

After public clients, geocompy (MIT) and DMPACK (ISC), and the reference manuals they
cite. No real instrument was on the wire.
"""

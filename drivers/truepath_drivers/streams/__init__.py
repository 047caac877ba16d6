"""Streams of samples and lines, for any driver; the shipped ones are made of it.

numbering      numbers of samples from a counter, from times, or over several starts
reordering     records of UDP in the order of their numbers
line_feeding   lines sent as the receive buffer of a device has room
received_bytes the bytes of a link, for the Run
"""

"""Bytes in and out of ports, with arrival stamps and timeouts. Knows no protocol."""

"""Bytes in and out of ports, every wait bounded. Knows no protocol.

`BytePort` is the interface; `SerialPort`, `TcpPort` and `UdpPort` implement it.
"""

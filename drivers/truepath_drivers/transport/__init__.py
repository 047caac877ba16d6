"""Bytes in and out of ports, every wait bounded. Knows no protocol.

`BytePort` is the interface; `SerialPort` and `TcpPort` are the two ways to a device.
"""

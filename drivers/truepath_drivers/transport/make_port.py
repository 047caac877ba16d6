"""Choice of the port from options of a driver."""

from __future__ import annotations

from truepath_drivers.transport.byte_port import BytePort
from truepath_drivers.transport.serial_port import SerialPort
from truepath_drivers.transport.tcp_port import TcpPort


def make_port(
    port: str | int, host: str | None, baudrate: int, silent_s: float | None = None
) -> BytePort:
    """A TCP connection if there is a host, else a serial port by its path.

    silent_s : after which a TCP connection is given up whose peer takes no bytes
    """
    if host is not None:
        return TcpPort(host, int(port), silent_s)
    if isinstance(port, int):
        raise ValueError(f"port {port} is a TCP port number: give its host as well")
    return SerialPort(port, baudrate)

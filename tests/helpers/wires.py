"""The device's end of a serial line or of a TCP connection, and a thread at it."""

import contextlib
import os
import select
import socket
import threading
import tty

from truepath_drivers.transport.byte_port import BytePort


class PtyWire:
    def __init__(self, *, is_raw=True):
        self.master, self.slave = os.openpty()
        if is_raw:
            tty.setraw(self.slave)
        self.options = {"port": os.ttyname(self.slave)}

    def read(self, timeout_s):
        if not select.select([self.master], [], [], timeout_s)[0]:
            return b""
        return os.read(self.master, 4096)

    def write(self, data):
        os.write(self.master, data)

    def unplug(self):
        for end in (self.master, self.slave):
            with contextlib.suppress(OSError):
                os.close(end)


class TcpWire:
    """The device end of a TCP connection; a new host takes the place of the last."""

    def __init__(self):
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._host = None
        self.connections = 0
        self.options = {"host": "127.0.0.1", "port": self._listener.getsockname()[1]}

    def read(self, timeout_s):
        host = self._host
        ends = [self._listener] if host is None else [self._listener, host]
        try:
            ready = select.select(ends, [], [], timeout_s)[0]
        except (OSError, ValueError):
            return b""  # a test has dropped the connection meanwhile
        if self._listener in ready:
            self.drop()
            self._host, _ = self._listener.accept()
            self.connections += 1
        elif host in ready:
            with contextlib.suppress(OSError):
                if data := host.recv(4096):
                    return data
            self.drop()
        return b""

    def write(self, data):
        if self._host is not None:
            with contextlib.suppress(OSError):
                self._host.sendall(data)

    def drop(self, *, reset=False):
        host, self._host = self._host, None
        if host is not None:
            if reset:
                linger = b"\1\0\0\0\0\0\0\0"
                host.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
            host.close()

    def unplug(self):
        self.drop()
        self._listener.close()


class HandPort(BytePort):
    """A port without a wire: gives once what is due, which a test puts there."""

    name = "wire"
    open = close = write = lambda *_: None

    def __init__(self, due: bytes = b"") -> None:
        self.due = due

    def read(self, timeout_s: float) -> bytes:
        due, self.due = self.due, b""
        return due


class Peer:
    """A thread at the device end of a wire."""

    def __init__(self, wire):
        self.wire = wire
        self.options = wire.options
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="peer")

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self.unplug()

    def halt(self):
        self._closing.set()
        self._thread.join()

    def unplug(self):
        self.halt()
        self.wire.unplug()

    def _run(self):
        while not self._closing.is_set():
            self.step(self.wire.read(0.004))

    def step(self, data):
        raise NotImplementedError

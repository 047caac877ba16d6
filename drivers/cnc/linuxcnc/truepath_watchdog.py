"""Beats from Truepath to HAL, on the computer of LinuxCNC, by the system's Python.

Loaded by `truepath.hal`. A client sends a line, `beat`, `arm`, `disarm` or `state`, and
gets `idle`, `armed` or `tripped`. Only beats of the client that armed it last count. A
client that goes without `disarm` leaves it armed: no beat comes then, and the feed is
inhibited.
"""

import argparse
import contextlib
import select
import socket
import time

# Several cycles of the servo thread: it must have seen that it was disarmed.
DISARMED_S = 0.01
COMMANDS = ("beat", "arm", "disarm", "state")


class Watchdog:
    """The pins of the component."""

    def __init__(self):
        import hal  # pyright: ignore[reportMissingImports], beside LinuxCNC only

        self.pins = hal.component("truepath")
        for name in ("beat", "armed"):
            self.pins.newpin(name, hal.HAL_BIT, hal.HAL_OUT)
        for name in ("tripped", "reset"):
            self.pins.newpin(name, hal.HAL_BIT, hal.HAL_IN)
        self.pins.ready()
        self.was_reset = False
        self.owner = None

    def obey(self, command, client):
        """Do what a line of a client says; return the state after it."""
        if command in ("arm", "disarm"):
            self.pins["armed"] = False
            time.sleep(DISARMED_S)
            self.pins["armed"] = command == "arm"
            self.owner = client
        if command in ("arm", "beat") and client is self.owner:
            self.pins["beat"] = not self.pins["beat"]
        if command == "arm":
            time.sleep(DISARMED_S)
        if not self.pins["armed"]:
            return "idle"
        return "tripped" if self.pins["tripped"] else "armed"

    def look_at_reset(self):
        """Disarm where somebody at the machine asks for it."""
        if self.pins["reset"] and not self.was_reset:
            self.obey("disarm", None)
        self.was_reset = self.pins["reset"]


def serve(watchdog, server):
    """Answer all clients, for ever."""
    rest = {}
    while True:
        ready, _, _ = select.select([server, *rest], [], [], 0.05)
        watchdog.look_at_reset()
        for one in ready:
            if one is server:
                client, _ = server.accept()
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                client.settimeout(0.2)
                rest[client] = b""
                continue
            try:
                rest[one] = answer(watchdog, one, rest[one])
            except OSError:
                del rest[one]
                one.close()


def answer(watchdog, client, rest):
    """Answer the whole lines of a client; return what is left."""
    data = client.recv(4096)
    if not data:
        raise OSError("the client has gone")
    *lines, rest = (rest + data).split(b"\n")
    for line in lines:
        command = line.decode("ascii", "replace").strip()
        reply = watchdog.obey(command, client) if command in COMMANDS else "unknown"
        client.sendall(reply.encode() + b"\n")
    return rest[-100:]


def main():
    """Serve until the component is ended."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--listen", default="127.0.0.1:5017", metavar="ADDRESS:PORT")
    address, _, port = parser.parse_args().listen.rpartition(":")
    server = socket.create_server((address, int(port)))
    with contextlib.suppress(KeyboardInterrupt):
        serve(Watchdog(), server)


if __name__ == "__main__":
    main()

"""Beats from Truepath to HAL, on the computer of LinuxCNC, by the system's Python.

Loaded by `truepath.hal`. A client sends a line, `beat`, `arm`, `disarm` or `state`, and
gets `idle`, `armed` or `tripped`; for `dead` the names of what does not run. Only beats
of the client that armed it last count. A client that goes without `disarm` leaves it
armed: no beat comes then, and the feed is inhibited. So it is while LinuxCNC's task or
its I/O is dead or stopped: what they have planned would go on.
"""

import argparse
import contextlib
import pathlib
import select
import socket
import time

# Several cycles of the servo thread: it must have seen that it was disarmed.
DISARMED_S = 0.01
TASKS = ("milltask", "io")
COMMANDS = ("beat", "arm", "disarm", "state")


def find_tasks():
    """Names and process ids of LinuxCNC's task and I/O."""
    found = []
    for folder in pathlib.Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            name = (folder / "comm").read_text().strip()
            if name in TASKS:
                found.append((name, folder.name))
    return found


def runs(process):
    """Whether a process exists and is not stopped."""
    try:
        text = pathlib.Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return False
    return text.rpartition(")")[2].split()[0] not in "TtZX"


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
        self.tasks = []

    def obey(self, command, client):
        """Execute a line of a client; gives the state after it."""
        if command in ("arm", "disarm"):
            self.pins["armed"] = False
            time.sleep(DISARMED_S)
            self.pins["armed"] = command == "arm"
            self.owner, self.tasks = client, find_tasks()
        is_ours = command in ("arm", "beat") and client is self.owner
        if is_ours and not self.list_dead():
            self.pins["beat"] = not self.pins["beat"]
        if command == "arm":
            time.sleep(DISARMED_S)
        if not self.pins["armed"]:
            return "idle"
        return "tripped" if self.pins["tripped"] else "armed"

    def list_dead(self):
        """Names of processes that ran when it was armed and do not run now."""
        return [name for name, process in self.tasks if not runs(process)]

    def check_reset(self):
        """Disarm when the reset pin rises: an operator at the machine requests it."""
        if self.pins["reset"] and not self.was_reset:
            self.obey("disarm", None)
        self.was_reset = self.pins["reset"]


def serve(watchdog, server):
    """Answer all clients, for ever."""
    rest = {}
    while True:
        ready, _, _ = select.select([server, *rest], [], [], 0.05)
        watchdog.check_reset()
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
    """Answer the complete lines of a client; gives the incomplete rest."""
    data = client.recv(4096)
    if not data:
        raise OSError("the client has gone")
    *lines, rest = (rest + data).split(b"\n")
    for line in lines:
        command = line.decode("ascii", "replace").strip()
        reply = watchdog.obey(command, client) if command in COMMANDS else "unknown"
        if command == "dead":
            reply = "dead " + " ".join(watchdog.list_dead())
        client.sendall(reply.encode() + b"\n")
    return rest[-100:]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--listen", default="127.0.0.1:5017", metavar="ADDRESS:PORT")
    address, _, port = parser.parse_args().listen.rpartition(":")
    server = socket.create_server((address, int(port)))
    with contextlib.suppress(KeyboardInterrupt):
        serve(Watchdog(), server)


if __name__ == "__main__":
    main()

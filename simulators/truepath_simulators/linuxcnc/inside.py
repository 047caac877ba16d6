"""Runs next to LinuxCNC in its namespaces, by the system's Python: `inside.py ORDERS`.

Starts LinuxCNC, reports when it listens, forwards connections to its ports and its
positions to a descriptor. As the first process of its namespace it ends everything
inside when it ends, which it does with its standard input.
"""

import json
import os
import select
import socket
import subprocess
import sys
import threading
import time

START_S = 20.0


def main(orders):
    """Start what was ordered; ends with standard input."""
    log = open("run.log", "w")  # noqa: SIM115, it lives as long as LinuxCNC
    linuxcnc = subprocess.Popen(
        ["/usr/bin/linuxcnc", "-r", "machine.ini"],
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=log,
        start_new_session=True,
    )
    beside = []
    for descriptor, port in orders["ports"]:
        if port == orders.get("gateway_port"):
            beside.append(start_gateway(orders["gateway"]))
        if not wait_for(port, (beside or [linuxcnc])[-1]):
            print(f"nothing listens on port {port}", flush=True)
            return
        server = socket.socket(fileno=descriptor)
        threading.Thread(target=serve, args=(server, port), daemon=True).start()
    if orders["positions"] is not None:
        subprocess.Popen(["/usr/bin/halsampler", "-t"], stdout=orders["positions"])
    print("ready", flush=True)
    sys.stdin.read()


def start_gateway(command):
    """Start the program that serves LinuxCNC's other masters."""
    log = open("gateway.log", "w")  # noqa: SIM115, it lives as long as the gateway
    return subprocess.Popen(  # noqa: S603, our own module
        command, stdin=subprocess.DEVNULL, stderr=log
    )


def wait_for(port, process):
    """Whether a port answers before the process ends."""
    deadline_s = time.monotonic() + START_S
    while time.monotonic() < deadline_s and process.poll() is None:
        try:
            with socket.create_connection(("127.0.0.1", port), START_S) as peer:
                # linuxcncrsh listens a second before it answers; a Modbus server
                # closes what is no request.
                peer.sendall(b"hello EMC rig 1\r\n")
                peer.recv(100)
                return True
        except OSError:
            time.sleep(0.02)
    return False


def serve(server, port):
    """Connect every client to a port inside."""
    while True:
        outer, _ = server.accept()
        inner = socket.create_connection(("127.0.0.1", port))
        threading.Thread(target=join, args=(outer, inner), daemon=True).start()


def join(outer, inner):
    """Forward bytes both ways until one side ends."""
    other = {outer: inner, inner: outer}
    for side in other:
        side.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    with outer, inner:
        try:
            while True:
                for side in select.select([outer, inner], [], [])[0]:
                    data = side.recv(65536)
                    if not data:
                        return
                    other[side].sendall(data)
        except OSError:
            return


if __name__ == "__main__":
    os.umask(0o022)
    main(json.loads(sys.argv[1]))

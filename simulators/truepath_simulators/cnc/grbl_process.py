"""GRBL on a pseudo-terminal: `python -m truepath_simulators.cnc.grbl_process`.

Every further line of input is something that happens to it: `door open`, `door close`,
`alarm N`, `mute`, `speak`, `restart`, or a question for its state.
"""

from __future__ import annotations

import select
import time
from pathlib import Path

from truepath_simulators.child import LifeLine, is_question
from truepath_simulators.cnc.grbl_device import GrblDevice
from truepath_simulators.links.links import PtyPort
from truepath_simulators.machine_clock import MachineClock

_PERIOD_S = 0.005


def main() -> None:
    """Serve until the parent ends."""
    life = LifeLine()
    orders = life.orders()
    if not orders:
        return
    link = orders.get("symlink")
    port = PtyPort(Path(link) if link else None)
    clock = MachineClock(time.monotonic_ns(), orders.get("speed", 1.0))
    device = GrblDevice(homes=orders.get("homes", True))
    life.report(port.address)
    try:
        while not life.ended:
            for line in life.lines():
                _happen(life, device, line)
            device.update(clock.now_s())
            device.receive(port.receive() or b"")
            port.send(device.take())
            waited = [life.descriptor, *port.descriptors()]
            select.select(waited, [], [], _PERIOD_S)
    finally:
        port.close()


def _happen(life: LifeLine, device: GrblDevice, line: str) -> None:
    what, _, which = line.partition(" ")
    if is_question(line):
        told = {"state": device.state, "position": device.position.tolist()}
        life.report(told | {"overflows": device.overflows})
    elif what == "door":
        device.open_door(which == "open")
    elif what == "alarm":
        device.trip(int(which))
    elif what in ("mute", "speak"):
        device.is_mute = what == "mute"
    elif what == "restart":
        device.restart()


if __name__ == "__main__":
    main()

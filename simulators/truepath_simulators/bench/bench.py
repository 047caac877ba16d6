"""Tracker and CNC as processes, for demonstrations and tests."""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np

from truepath_simulators.compensation.correction import Rules, measure_deviation_mm
from truepath_simulators.compensation.loading import LoadedTables
from truepath_simulators.errors import SimulatorError
from truepath_simulators.faults import parse_fault
from truepath_simulators.hidden.effect import HiddenEffect, locate_target_mm
from truepath_simulators.hidden.effects_by_name import as_json, parse_hidden
from truepath_simulators.hidden.motion import MotionFollower
from truepath_simulators.links.links import require_free
from truepath_simulators.machine.random_machine import random_machine
from truepath_simulators.machine.tracker_head import (
    TrackerPose,
    random_clock,
    random_pose,
    reposition,
)
from truepath_simulators.machine.truth_machine import TruthMachine
from truepath_simulators.machine_file import load_machine, parse_machine
from truepath_simulators.motion.followed_positions import open_source
from truepath_simulators.motion.profile import Limits
from truepath_simulators.processes import DeviceProcess, DeviceProcesses, MachineClock
from truepath_simulators.timeline import BoardReader, new_board

_HOSTS = {"thermometers": "cnc"}  # devices in the process of another


@dataclass(frozen=True, slots=True)
class FollowedMotion:
    """Axis positions and target at some times.

    time_s : (n,) of the machine's clock
    position : (n, axes) as commanded
    target_mm : (n, 3) in the frame on which the tracker stands
    """

    time_s: np.ndarray
    position: np.ndarray
    target_mm: np.ndarray


class Bench(DeviceProcesses):
    """A simulated machine with its tracker, behind real links.

    machine : content of machine.json; the bundled demonstration machine if None
    speed : device clocks run so many times faster than the wall clock; the time limits
        of links (keep-alive, watchdog) stay in wall seconds
    faults : see `truepath_simulators.faults`; `inject` adds more while it runs
    workdir : holds the links `tracker` and `modbus-rtu` to the terminals
    tracker : link of the tracker, `pty` or `tcp`
    source : axis positions in place of the simulated CNC, a name or a descriptor, see
        `followed_positions`; source_unit_s : a step of its first column
    protocol : `gst` where it streams; `geocom` and `t2sa` are polled
    hidden : effects outside of a rigid-body model, or `name[*size_um]`, sampled by the
        seed; their time begins with the bench
    compensation : tables of the controller, or their files
    """

    def __init__(
        self,
        machine: Mapping[str, Any] | None = None,
        seed: int = 1,
        speed: float = 1.0,
        faults: Sequence[str] = (),
        workdir: Path | None = None,
        *,
        tracker: Literal["pty", "tcp"] = "pty",
        host: str = "127.0.0.1",
        tracker_port: int = 0,
        modbus_port: int = 0,
        error_scale: float = 1.0,
        limits: Limits | None = None,
        rtu: bool = True,
        hidden: Sequence[HiddenEffect | str] = (),
        source: str | int | None = None,
        source_unit_s: float = 1.0,
        protocol: Literal["gst", "geocom", "t2sa"] = "gst",
        compensation: LoadedTables | Sequence[Path | str] = (),
    ) -> None:
        super().__init__(
            workdir,
            tracker=tracker,
            host=host,
            tracker_port=tracker_port,
            modbus_port=modbus_port,
            rtu=rtu,
        )
        if not 0.0 < speed < math.inf:
            raise SimulatorError(f"speed: {speed} is not above zero")
        if protocol == "t2sa" and tracker == "pty":
            raise SimulatorError("tracker: T2SA is reached over TCP alone; choose tcp")
        self._content = dict(machine) if machine is not None else load_machine("demo")
        nominal = parse_machine(self._content)
        self.truth: TruthMachine = random_machine(nominal, seed, scale=error_scale)
        self.hidden = tuple(
            parse_hidden(one, seed, nominal) if isinstance(one, str) else one
            for one in hidden
        )
        self._clock = random_clock(seed)
        self._faults = [(parse_fault(text).device, text) for text in faults]
        self.has_rtu = rtu and source is None
        self._source, self._source_unit_s = source, source_unit_s
        self._common = {
            "machine": self._content,
            "seed": seed,
            "speed": speed,
            "error_scale": error_scale,
            "protocol": protocol,
            "limits": asdict(limits or Limits()),
            "hidden": [as_json(effect) for effect in self.hidden],
        }
        self._reader: BoardReader | None = None
        self._pose = random_pose(nominal, seed)
        self._follower = MotionFollower(nominal, remembers=bool(self.hidden))
        self._use_tables(compensation)

    @property
    def machine(self) -> Mapping[str, Any]:
        return self._content

    @property
    def pose(self) -> TrackerPose:
        """Pose of the tracker in the frame on which it stands."""
        return self._pose

    def start(self) -> Self:
        """Start both processes; blocks until both listen.

        Raises SimulatorError if one does not start.
        """
        links = self._place_links()
        if self._workdir is not None:
            for name in ("tracker", "modbus-rtu"):
                require_free(self._workdir / name)
        motion = new_board() if self._source is None else _open(self._source)
        self._common |= {
            "epoch_ns": time.monotonic_ns(),
            "board": motion,
            "source_unit_s": None if self._source is None else self._source_unit_s,
        }
        if self._source is not None:
            del links["cnc"]
        try:
            for device, link in links.items():
                faults = [
                    t for name, t in self._faults if _HOSTS.get(name, name) == device
                ]
                orders = self._common | {"link": link, "faults": faults}
                module = f"{device}.{device}_process"
                self._processes[device] = DeviceProcess(module, orders, [motion])
            for device, process in self._processes.items():
                self._addresses[device] = process.listening()
            if self._source is None:
                self._reader = BoardReader(motion)
        except BaseException:
            self.close()
            raise
        finally:
            os.close(motion)
        return self

    def inject(self, fault: str) -> None:
        """Start a fault now, or after its own delay."""
        named = parse_fault(fault).device
        device = _HOSTS.get(named, named)
        if device not in self._processes:
            raise SimulatorError(f"{fault}: there is no simulated {named} here")
        self._processes[device].tell(fault)

    def move_tracker(self, place_mm: Sequence[float], number: int = 1) -> None:
        """Move the tracker to a position, with a new orientation by the number."""
        place = [float(v) for v in place_mm]
        self._processes["tracker"].tell(json.dumps({"place": place, "number": number}))
        self._pose = reposition(place, self._common["seed"] + 1000 * number)

    def load_compensation(
        self,
        compensation: LoadedTables | Sequence[Path | str],
        rules: Mapping[str, Any] | None = None,
    ) -> None:
        """Replace the controller's tables while its axes stand; none without files.

        rules : of files, as in `truepath_simulators.compensation.correction.Rules`

        Raises SimulatorError if the axes move, or naming the fault of the tables.
        """
        if self._reader is not None:
            timeline = self._reader.timeline()
            if timeline is not None and timeline.end_s > self.now_s():
                raise SimulatorError("the axes move; load tables while they stand")
        if not isinstance(compensation, LoadedTables):
            compensation = LoadedTables.from_paths(compensation, Rules(**(rules or {})))
        self._use_tables(compensation)
        for device in self._processes.values():
            device.tell(json.dumps({"compensation": self.compensation.as_json()}))

    def read_state(self) -> dict[str, Any]:
        """State of every device, and names of the loaded tables."""
        state = super().read_state()
        state.get("cnc", {})["compensation"] = list(self.compensation.files)
        return state

    def truth_at(self, points_mm: np.ndarray, direction: float = 1.0) -> np.ndarray:
        """True volumetric error, µm, at axis positions, (n, 3).

        With the loaded tables, all axes arriving in the direction.
        """
        points = np.asarray(points_mm, float)
        return 1e3 * measure_deviation_mm(
            self.truth, self._correction, points, direction
        )

    def now_s(self) -> float:
        return MachineClock(self._common["epoch_ns"], self._common["speed"]).now_s()

    def follow(self, time_s: np.ndarray, target: str = "") -> FollowedMotion:
        """True axes and target at times (n,) of the machine's clock.

        Up to now, and as far back as the last minute of the wall clock; with hidden
        effects, without the pose of the tracker and its noise.
        """
        timeline = None if self._reader is None else self._reader.timeline()
        if timeline is None:
            raise SimulatorError(
                "the bench has not started"
                if self._source is None
                else "its positions come from outside: ask their source, and truth"
            )
        motion, time_s = self._follower.follow(timeline), np.asarray(time_s, float)
        name = target or self.truth.machine.reflectors[0].name
        names = [name] * len(time_s)
        place = locate_target_mm(self.truth, motion, time_s, names, self.hidden)
        return FollowedMotion(time_s, timeline.positions(time_s), place)

    def hidden_truth(self) -> list[dict[str, Any]]:
        """Hidden effects in the form of `discovery.json`."""
        return [effect.truth(self._clock) for effect in self.hidden]

    def close(self) -> None:
        super().close()
        if self._reader is not None:
            self._reader.close()
            self._reader = None

    def _use_tables(self, compensation: LoadedTables | Sequence[Path | str]) -> None:
        tables = (
            compensation
            if isinstance(compensation, LoadedTables)
            else LoadedTables.from_paths(compensation)
        )
        self._correction = tables.correct(self.truth.machine)
        self.compensation = tables
        self._common["compensation"] = tables.as_json()
        self._follower.correct(self._correction)


def _open(source: str | int) -> int:
    return open_source(source) if isinstance(source, str) else os.dup(source)

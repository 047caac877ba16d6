"""The REST interface as the page needs it, played step by step by a test.

Nothing moves by itself: the test says when a job is ready, how far it is, how it ends.
"""

from __future__ import annotations

import asyncio
import copy
import itertools
import json
import math
import threading
from typing import Any

import numpy as np
from fastapi import FastAPI, Request, UploadFile
from fastapi.responses import JSONResponse, Response, StreamingResponse

from app.web.pages import STATIC_PATH, router, static_files

MACHINE = {
    "schema": "machine/1",
    "name": "VMC 500",
    "kinematic_chain": "w-X-b-Y-Z-t",
    "axes": {
        "X": {"type": "linear", "min_mm": 0.0, "max_mm": 500.0},
        "Y": {"type": "linear", "min_mm": 0.0, "max_mm": 400.0},
        "Z": {"type": "linear", "min_mm": -300.0, "max_mm": 0.0},
    },
    "tool_offset_mm": [20.0, 30.0, -150.0],
}
TRACKER_NOISE = {"range_sigma_um": 1.0, "angle_sigma_urad": 3.0, "rate_hz": 500}
TRACKER_STANDS_MM = np.array([1200.0, 300.0, -80.0])
TRACKER = {
    "maker": "Truepath",
    "model": "Simulated tracker",
    "serial_number": "T-0001",
    "firmware": "1.0",
}
MOTION = {
    "maker": "Truepath",
    "model": "Simulated CNC",
    "serial_number": "C-0001",
    "firmware": "1.0",
}
ENDED = {"succeeded", "aborted", "failed", "faulted", "interrupted"}
API = "/api/v1"


def planned_path(lines: int = 22) -> dict[str, Any]:
    """Return chords through the travel, ends on its faces."""
    rng = np.random.default_rng(5)
    low = np.array([10.0, 10.0, -290.0])
    high = np.array([490.0, 390.0, -10.0])
    share = rng.random((lines + 1, 3))
    share[np.arange(lines + 1), rng.integers(0, 3, lines + 1)] = (
        np.arange(lines + 1) % 2
    )
    share[0] = 0.0
    position = low + share * (high - low)
    return {
        "kind": "path",
        "axes": ["X", "Y", "Z"],
        "position": np.round(position, 3).tolist(),
        "feed_mm_min": [6000.0] * len(position),
        "dwell_s": [0.35] * len(position),
    }


def result() -> dict[str, Any]:
    """Return smooth error tables with uncertainties that open towards the ends."""
    rng = np.random.default_rng(11)
    tables = {}
    for axis in "XYZ":
        travel = MACHINE["axes"][axis]
        position = np.linspace(travel["min_mm"], travel["max_mm"], 21)
        s = np.linspace(0.0, 1.0, len(position))
        for motion in "XYZABC":
            unit = "um" if motion in "XYZ" else "urad"
            size = 6.0 if unit == "um" else 14.0
            waves = sum(
                rng.normal(scale=1.0 / k) * np.sin(k * math.pi * s + rng.uniform(0, 6))
                for k in (1, 2, 3)
            )
            waves = size * (waves - waves[0])
            if unit == "um" and motion != axis:
                waves = waves - s * waves[-1]
            u = (0.25 if unit == "um" else 0.8) * (1 + 1.6 * (2 * s - 1) ** 2)
            tables[f"E{motion}{axis}"] = {
                "position_mm": position.round(3).tolist(),
                f"value_{unit}": waves.round(3).tolist(),
                f"uncertainty_{unit}": u.round(3).tolist(),
            }
    del tables["ECZ"]
    return {
        "schema": "result/1",
        "machine": MACHINE,
        "mode": "otf",
        "error_tables": tables,
        "squareness_urad": {
            "C0Y": {"value": 23.4, "uncertainty": 0.9},
            "B0Z": {"value": -11.8, "uncertainty": 1.1},
            "A0Z": {"value": 5.2, "uncertainty": 1.2},
        },
        "alignment": {},
        "residuals": {"rms_um": 4.3},
        "observability": {
            "rank": 161,
            "parameters": 165,
            "unobservable": [
                "ECZ (roll of Z) cannot be told from EXZ, EYZ with this offset"
            ],
        },
        "provenance": {},
    }


def problem(status: int, code: str, title: str, detail: str, action: str) -> Response:
    body = {
        "type": f"/problems/{code}",
        "code": code,
        "title": title,
        "detail": detail,
        "action": action,
        "status": status,
    }
    return JSONResponse(body, status, media_type="application/problem+json")


def event_text(kind: str, body: Any) -> str:
    return f"event: {kind}\ndata: {json.dumps(body)}\n\n"


class ScriptedService:
    """State of the service, changed by the test and by the page."""

    def __init__(self) -> None:
        self.connected = False
        self.silent = False
        self.refuse_connect = False
        self.deaf_to_stop = False
        self.stops = 0
        self.requests: list[tuple[str, str, Any]] = []
        self.jobs: dict[str, dict[str, Any]] = {}
        self.runs: list[dict[str, Any]] = []
        self.plan = planned_path()
        self._numbers = itertools.count(1)
        self._streams: set[tuple[asyncio.AbstractEventLoop, asyncio.Queue[str]]] = set()
        self._lock = threading.Lock()
        self.closing = threading.Event()

    # What the test says.

    def new_job(self, kind: str, **more: Any) -> dict[str, Any]:
        number = next(self._numbers)
        job = {
            "id": f"job-{number}",
            "kind": kind,
            "state": "preparing" if kind != "analyse" else "running",
            "desired_state": "ready",
            "version": 1,
            "stage": "planning" if kind != "analyse" else "aligning",
            "progress": {"done": 0, "total": 0, "unit": "", "eta_s": None},
            "health": {"samples": 0, "lost_samples": 0, "crc_errors": 0},
            "created": f"2026-03-14T08:{number:02d}:00.000Z",
            "started": None,
            "ended": None,
            "run_id": None,
            "result": None,
            "error": None,
            **more,
        }
        self.jobs[job["id"]] = job
        self.tell("job", job)
        return job

    def change(self, job_id: str, **change: Any) -> None:
        """Change a job and tell everybody."""
        job = self.jobs[job_id]
        job.update(change, version=job["version"] + 1)
        if job["state"] in ENDED and not job["ended"]:
            job["ended"] = "2026-03-14T08:30:00.000Z"
        self.tell("job", job)

    def advance(self, job_id: str, lines: float, total: int = 22) -> None:
        """Tell that the machine has done so many lines."""
        rows = np.array(self.plan["position"])
        index = min(int(lines), len(rows) - 2)
        position = rows[index] + (lines - index) * (rows[index + 1] - rows[index])
        progress = {
            "done": int(lines),
            "total": total,
            "unit": "lines",
            "eta_s": 5.6 * (total - lines),
            "elapsed_s": 5.6 * lines,
            "stage": "measuring",
            "position": position.tolist(),
        }
        health = {"samples": int(2800 * lines), "lost_samples": 0, "crc_errors": 0}
        self.jobs[job_id].update(progress=progress, health=health)
        body = {
            "job_id": job_id,
            "stage": "measuring",
            "progress": progress,
            "health": health,
        }
        self.tell("progress", body)
        live = {
            "job_id": job_id,
            "axes": position.tolist(),
            "device_time_s": 5.6 * lines,
            "tracker_mm": [(position + TRACKER_STANDS_MM).tolist()],
        }
        self.tell("live", live)

    def finish(self, job_id: str) -> None:
        """Let the job succeed."""
        number = job_id.removeprefix("job-")
        run_id = self.jobs[job_id]["run_id"] or f"run-{number}"
        if all(run["id"] != run_id for run in self.runs):
            self.add_run(run_id)
        self.change(job_id, state="succeeded", stage="reporting", run_id=run_id)

    def add_run(self, run_id: str) -> dict[str, Any]:
        run = {
            "id": run_id,
            "name": f"VMC 500 {run_id}",
            "samples": 61600,
            "lost_samples": 0,
            "created": "2026-03-14T08:05:00.000Z",
        }
        self.runs.append(run)
        return run

    def tell(self, kind: str, body: Any) -> None:
        """Send one event to every page."""
        if self.silent:
            return
        text = event_text(kind, body)
        with self._lock:
            for loop, queue in self._streams:
                loop.call_soon_threadsafe(queue.put_nowait, text)

    # What the page asks.

    def act(self, job_id: str, verb: str) -> dict[str, Any]:
        state = {
            "arm": "running",
            "pause": "paused",
            "resume": "running",
            "abort": "aborted",
        }[verb]
        more = {"stage": "measuring"} if verb == "arm" else {}
        self.change(job_id, state=state, **more)
        return self.jobs[job_id]

    def stop(self) -> list[dict[str, Any]]:
        self.stops += 1
        if self.deaf_to_stop:
            return []
        active = [j for j in self.jobs.values() if j["state"] not in ENDED]
        for job in active:
            self.change(job["id"], state="aborted")
        return active

    async def events(self, request: Request) -> Any:
        queue: asyncio.Queue[str] = asyncio.Queue()
        entry = (asyncio.get_running_loop(), queue)
        with self._lock:
            self._streams.add(entry)
        try:
            for job in [j for j in self.jobs.values() if j["state"] not in ENDED]:
                yield event_text("job", job)
            while not self.closing.is_set() and not await request.is_disconnected():
                try:
                    yield await asyncio.wait_for(queue.get(), 0.25)
                except TimeoutError:
                    if not self.silent:
                        yield event_text("tick", {})
        finally:
            with self._lock:
                self._streams.discard(entry)


def scripted_app(service: ScriptedService) -> FastAPI:
    """Return the page and the REST interface that the script plays."""
    app = FastAPI(docs_url=None, redoc_url=None)
    app.include_router(router)
    app.mount(STATIC_PATH, static_files())

    def machine() -> dict[str, Any]:
        found = copy.deepcopy(MACHINE)
        known = service.connected
        return found | {
            "tracker_noise": TRACKER_NOISE,
            "connected": known,
            "tracker": TRACKER if known else None,
            "motion": MOTION if known else None,
        }

    @app.get(f"{API}/system")
    def system() -> dict[str, Any]:
        cell = {"state": "ready" if service.connected else "idle"}
        return {"version": "0", "simulated": True, "machine": MACHINE, "cell": cell}

    @app.get(f"{API}/machines/current")
    def current() -> dict[str, Any]:
        return machine()

    @app.post(f"{API}/machines/current:connect")
    def connect() -> Any:
        if service.refuse_connect:
            return problem(
                409,
                "wrong-device",
                "Another device answers",
                "The tracker's port is answered by a barcode reader.",
                "Check the cable, then connect again.",
            )
        service.connected = True
        return {"connected": True, "tracker": TRACKER, "motion": MOTION}

    @app.get(f"{API}/jobs")
    def jobs(limit: int = 50) -> Any:
        newest = sorted(service.jobs.values(), key=lambda j: j["created"], reverse=True)
        return {"items": newest[:limit], "next": None}

    @app.post(f"{API}/jobs", status_code=202)
    async def create(request: Request) -> Any:
        order = await request.json()
        service.requests.append(("POST", "/jobs", order))
        return service.new_job(order["kind"], run_id=order.get("run_id"))

    @app.get(f"{API}/jobs/{{job_id}}")
    def job(job_id: str) -> Any:
        if job_id not in service.jobs:
            return problem(404, "not-found", "No such job", job_id, "")
        return service.jobs[job_id]

    @app.post(f"{API}/jobs/{{job_id}}/{{verb}}", status_code=202)
    def act(job_id: str, verb: str, request: Request) -> Any:
        version = request.headers.get("if-match")
        service.requests.append(("POST", f"/jobs/{job_id}/{verb}", version))
        return service.act(job_id, verb)

    @app.post(f"{API}/stop", status_code=202)
    def stop() -> Any:
        return {"jobs": service.stop()}

    @app.get(f"{API}/jobs/{{job_id}}/plan")
    def plan(job_id: str) -> Any:
        return service.plan

    @app.get(f"{API}/nc-dialects")
    def nc_dialects() -> Any:
        return {"items": [{"name": "heidenhain", "control": "Heidenhain TNC"}]}

    @app.get(f"{API}/jobs/{{job_id}}/nc-program")
    def nc_program(job_id: str, dialect: str) -> Response:
        return Response(
            "0 BEGIN PGM\n",
            media_type="text/plain",
            headers={"Content-Disposition": f'attachment; filename="{dialect}.h"'},
        )

    @app.get(f"{API}/jobs/{{job_id}}/result")
    def job_result(job_id: str) -> Any:
        return result()

    @app.get(f"{API}/jobs/{{job_id}}/result/error-tables.csv")
    def table(job_id: str) -> Response:
        return Response("error,position_mm\n", media_type="text/csv")

    @app.get(f"{API}/runs")
    def runs() -> Any:
        return {"items": service.runs, "next": None}

    @app.post(f"{API}/runs", status_code=201)
    async def upload(bundle: UploadFile) -> Any:
        service.requests.append(("POST", "/runs", bundle.filename))
        return service.add_run("run-uploaded")

    @app.get(f"{API}/events")
    def events(request: Request) -> StreamingResponse:
        return StreamingResponse(
            service.events(request), media_type="text/event-stream"
        )

    return app

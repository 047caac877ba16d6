"""The REST interface as the page needs it, played step by step by a test.

Nothing moves by itself: the test says when a job is ready, how far it is, how it ends.
"""

import asyncio
import itertools
import json
import threading
from contextlib import contextmanager

import numpy as np

import scripted_data as data

_STAGES = {"analyse": "aligning", "discover": "discovering", "trend": "following"}
ENDED = {"succeeded", "aborted", "cancelled", "failed", "faulted", "interrupted"}
NOTHING_YET = ("started", "ended", "run_id", "monte_carlo", "result", "error")
NOTHING_YET += ("target_um", "early_end")
COUNTS = ("samples", "lost_samples", "crc_errors", "gaps", "repeats")


def event_text(kind, body):
    return json.dumps({"event": kind, "data": body})


class ScriptedService:
    """State of the service, changed by the test and by the page."""

    def __init__(self):
        self.connected = self.silent = self.refuse_connect = False
        self.log_in_required = self.deaf_to_stop = False
        self.controller = self.user = None
        self.stopped, self.stops = "unknown", 0
        self.requests, self.looks = [], []
        self.jobs, self.runs, self.conditions = {}, [], []
        self.plan = data.planned_path()
        self.planned = {"id": "plan-1", "state": "running"}
        self.grade, self.machine = data.EXAMPLES["get_plan_grade"], data.MACHINE
        self.discovery, self.result = data.DISCOVERY, data.result()
        self.estimates, self.verifications, self.trend = {}, {}, {}
        self.conformity = {
            "machine_tolerance_um": None,
            "before": {"conformity": "outside"},
            "after_expected": {"conformity": "within"},
        }
        self.machines, self.held_machine = [data.machine_entry()], ""
        self.histories, self.standings, self.changes = {}, {}, {}
        self.comparison, self.temperature = {}, {}
        self.temperature_refusal = "2 of 3 temperatures"
        self.compensations, self.rotary_account, self.loaded_tables = {}, {}, {}
        self.certificates, self.identity = {}, {}
        self._numbers = itertools.count(1)
        self._streams = set()
        self._lock = threading.Lock()
        self._kept_back = None
        self._answering = threading.Event()
        self._answering.set()
        self.closing = threading.Event()
        self.is_heard = threading.Event()

    # What the test says.

    def new_job(self, kind, **more):
        number = next(self._numbers)
        job = {
            **{"id": f"job-{number}", "kind": kind, "machine": "default", "version": 1},
            "state": "running" if kind in _STAGES else "preparing",
            "desired_state": "ready",
            "stage": _STAGES.get(kind, "planning"),
            "progress": {"done": 0, "total": 0, "unit": "", "eta_s": None},
            "health": dict.fromkeys(COUNTS, 0),
            "created": f"2026-03-14T08:{number:02d}:00.000Z",
            **dict.fromkeys(NOTHING_YET),
            "on_notice": "note",
            "notices": [],
            "links": {"verbs": {}},
            **more,
        }
        self.jobs[job["id"]] = job
        self.tell("job", job)
        return job

    def ready(self, kind="measure-otf", **more):
        self.connected = True
        return self.new_job(kind, **{"state": "ready", **more})["id"]

    def measuring(self, **more):
        """Let a measurement be under way; two of its lines are done."""
        job = self.ready(**{"state": "running", "stage": "measuring", **more})
        self.advance(job, 2.0)
        return job

    def measured(self, **more):
        with self.telling_late(only_last=True):
            job = self.measuring(**more)
            self.finish(job)
        return job

    def done(self, kind, **more):
        self.connected = True
        with self.telling_late(only_last=True):
            job = self.new_job(kind, **more)["id"]
            self.finish(job)
        return job

    def verified(self, content, **more):
        with self.telling_late(only_last=True):
            job = self.new_job("verify", **more)["id"]
            self.verifications[job] = content
            self.finish(job)
        return job

    def orders(self, path="/jobs"):
        return [body for *to, body in self.requests if to == ["POST", path]]

    def change(self, job_id, **change):
        job = self.jobs[job_id]
        job.update(change, version=job["version"] + 1)
        if job["state"] in ENDED and not job["ended"]:
            job["ended"] = "2026-03-14T08:30:00.000Z"
        self.tell("job", job)

    def advance(self, job_id, lines, total=22):
        rows = np.array(self.plan["position"])
        index = min(int(lines), len(rows) - 2)
        position = rows[index] + (lines - index) * (rows[index + 1] - rows[index])
        progress = {"done": int(lines), "total": total, "unit": "lines"}
        progress |= {"eta_s": 5.6 * (total - lines), "elapsed_s": 5.6 * lines}
        progress |= {"stage": "measuring", "position": position.tolist()}
        health = {**self.jobs[job_id]["health"], "samples": int(2800 * lines)}
        known = {"progress": progress, "health": health}
        self.jobs[job_id].update(known)
        self.tell("progress", {"job_id": job_id, "stage": "measuring", **known})
        points = [position + data.TRACKER_STANDS_MM]
        self.show_points(job_id, 5.6 * lines, points, axes=position.tolist())

    def show_points(self, job_id, end_s, points_mm, **more):
        points = np.asarray(points_mm).tolist()
        live = {"job_id": job_id, "axes": [0.0, 0.0, 0.0], "device_time_s": end_s}
        self.tell("live", {**live, "tracker_mm": points, **more})

    def estimate(self, job_id, content):
        """Tell an estimate: what it says, or after how many lines it is made."""
        body = data.estimate(content) if isinstance(content, int) else content
        before = self.estimates.get(job_id, {"course": {}})["course"]
        course = {
            name: [*before.get(name, []), body[name]]
            for name in ("elapsed_s", "done", "volumetric_uncertainty_um")
        }
        self.estimates[job_id] = {"job_id": job_id, **body, "course": course}
        self.tell("estimate", {"job_id": job_id, **body})

    def finish(self, job_id):
        number = job_id.removeprefix("job-")
        run_id = self.jobs[job_id]["run_id"] or f"run-{number}"
        if all(run["id"] != run_id for run in self.runs):
            self.add_run(run_id)
        self.change(job_id, state="succeeded", stage="reporting", run_id=run_id)

    def add_run(self, run_id):
        run = {"id": run_id, "name": f"VMC 500 {run_id}", "machine": "VMC 500"}
        run |= {"samples": 61600, "lost_samples": 0}
        run["created"] = "2026-03-14T08:05:00.000Z"
        self.runs.append(run)
        return run

    def tell(self, kind, body):
        if self.silent:
            return
        text = event_text(kind, body)
        if self._kept_back is not None:
            self._kept_back.append(text)
        else:
            self._send(text)

    @contextmanager
    def telling_late(self, only_last=False):
        """Tell no event before the end; what is asked is answered meanwhile.

        only_last : of the events, so that no page is led through what was before
        """
        self._kept_back = []
        yield
        late, self._kept_back = self._kept_back, None
        for text in late[-1:] if only_last else late:
            self._send(text)

    @contextmanager
    def answering_late(self):
        """Answer no verb before the end; its events are told meanwhile."""
        self._answering.clear()
        try:
            yield
        finally:
            self._answering.set()

    def _send(self, text):
        with self._lock:
            for loop, queue in self._streams:
                loop.call_soon_threadsafe(queue.put_nowait, text)

    # What the page asks.

    async def note(self, request):
        """Keep what the page sends; return its body."""
        body = await request.json()
        path = request.url.path.removeprefix("/api/v1")
        self.requests.append((request.method, path, body))
        return body

    def act(self, job_id, verb):
        states = {"arm": "running", "pause": "paused", "resume": "running"}
        states |= {"cancel": "cancelling", "acknowledge": "preparing"}
        states["abort"] = "aborting"
        state = states.get(verb, self.jobs[job_id]["state"])
        more = {"stage": "measuring"} if verb == "arm" else {}
        self.change(job_id, state=state, **more)
        answer = dict(self.jobs[job_id])
        if verb == "abort":  # answered when it is asked, confirmed by the next event
            self.change(job_id, state="aborted")
        self._answering.wait()
        return answer

    def stop(self):
        if self.deaf_to_stop:
            return []
        active = [j for j in self.jobs.values() if j["state"] not in ENDED]
        for job in active:
            self.change(job["id"], state="aborted")
        return active

    async def events(self):
        queue = asyncio.Queue()
        entry = (asyncio.get_running_loop(), queue)
        with self._lock:
            self._streams.add(entry)
        self.is_heard.set()
        try:
            for job in [j for j in self.jobs.values() if j["state"] not in ENDED]:
                yield event_text("job", job)
            while not self.closing.is_set():
                try:
                    yield await asyncio.wait_for(queue.get(), 0.25)
                except TimeoutError:
                    if not self.silent:
                        yield event_text("tick", {})
        finally:
            with self._lock:
                self._streams.discard(entry)


class Played:
    """Whatever service a test plays, for routes that outlast it."""

    def __getattr__(self, name):
        return getattr(self.__dict__["service"], name)

    def __setattr__(self, name, value):
        if name == "service":
            self.__dict__[name] = value
        else:
            setattr(self.__dict__["service"], name, value)

"""The routes by which the page talks to the scripted service."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Annotated, Any

from fastapi import FastAPI, Query, Request, UploadFile, WebSocket, WebSocketDisconnect
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, JSONResponse, Response

import scripted_data as data
from scripted_service import ScriptedService
from truepath.service.api.guard import Guard
from truepath.service.page.pages import STATIC_PATH, router, static_files

API = "/api/v1"
OPEN = (f"{API}/stop", f"{API}/stop:check", f"{API}/session")


def problem(
    status: int, code: str, title: str, detail: str, action: str, **more: Any
) -> Response:
    words = {"code": code, "title": title, "detail": detail, "action": action}
    body = {**more, **words, "type": f"/problems/{code}", "status": status}
    return JSONResponse(body, status, media_type="application/problem+json")


class RefuseNobody:
    """Lets a request through where nobody has to log in, or somebody has."""

    def __init__(self, app: Any, service: ScriptedService) -> None:
        self._app, self._service = app, service

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        path = scope.get("path", "")
        is_open = not path.startswith(API) or path in OPEN
        if is_open or self._service.user or not self._service.log_in_required:
            await self._app(scope, receive, send)
            return
        refused = problem(401, "not-logged-in", "Nobody is logged in", "", "")
        await refused(scope, receive, send)


def scripted_app(service: ScriptedService) -> FastAPI:
    app = FastAPI(docs_url=None, redoc_url=None)
    app.include_router(router)
    app.mount(STATIC_PATH, static_files())
    app.add_middleware(RefuseNobody, service=service)
    app.add_middleware(Guard)
    for path, answer in list_states(service).items():
        app.get(f"{API}/{path}")(answer)
    add_session(app, service)
    add_jobs(app, service)
    add_results(app, service)
    add_machines(app, service)
    add_motion(app, service)
    return app


def list_states(service: ScriptedService) -> dict[str, Callable[..., Any]]:
    def system() -> dict[str, Any]:
        cell = {"state": "ready" if service.connected else "idle"}
        known = {"machine": data.MACHINE, "simulated": True, "cell": cell}
        return data.EXAMPLES["get_system"] | known

    def current() -> dict[str, Any]:
        nothing = {"connected": False, "tracker": None, "motion": None}
        noise = {"tracker_noise": {"rate_hz": 500}}
        return (
            service.machine | noise | (data.DEVICES if service.connected else nothing)
        )

    def conditions() -> dict[str, Any]:
        return {"items": service.conditions}

    nowhere = problem(404, "not-found", "Not there", "Nothing is known", "")
    return {
        "system": system,
        "machines/current": current,
        "machines/current/conditions": conditions,
        "machines/{machine_id}/conditions": conditions,
        "machines": lambda: {"items": service.machines},
        "drivers": lambda: {"items": data.DRIVERS},
        "plans/{plan_id}/curve": data.plan_curve,
        "plans/{plan_id}": lambda: service.planned,
        "effects": lambda: {"items": data.EFFECTS},
        "compensation-formats": lambda: {"items": [*data.FORMATS.values()]},
        "nc-dialects": lambda: data.EXAMPLES["list_nc_dialects"],
        "jobs/{job_id}/plan": lambda: service.plan,
        "jobs/{job_id}/plan/grade": lambda: service.grade,
        "jobs/{job_id}/result": lambda: service.result,
        "jobs/{job_id}/discovery": lambda: service.discovery,
        "jobs/{job_id}/trend": lambda: service.trend,
        "jobs/{job_id}/verification": lambda job_id: service.verifications[job_id],
        "jobs/{job_id}/compensations": lambda job_id: {
            "items": service.compensations.get(job_id, [])
        },
        "jobs/{job_id}/certificates": lambda job_id: {
            "items": service.certificates.get(job_id, []),
            "identity": service.identity,
        },
        "jobs/{job_id}/result/volumetric-map": data.volumetric_map,
        "jobs/{job_id}": lambda job_id: service.jobs.get(job_id) or nowhere,
        "jobs/{job_id}/nc-program": lambda dialect: download(
            "0 BEGIN PGM\n", f"{dialect}.h", "text/plain"
        ),
        "jobs/{job_id}/estimate": lambda job_id: (
            service.estimates.get(job_id) or Response(status_code=204)
        ),
        "jobs/{job_id}/compensations/{name}/archive": lambda name: download(
            "PK", f"{name}.zip", "application/zip"
        ),
        "jobs/{job_id}/certificates/{number}.html": lambda number: HTMLResponse(
            f"<h1>Calibration certificate {number}</h1>"
        ),
        "machines/{machine_id}/standing": lambda machine_id: (
            service.standings.get(machine_id) or nowhere
        ),
        "machines/{machine_id}/history": lambda machine_id: service.histories.get(
            machine_id, {"entries": [], "calibrations": []}
        ),
        "models/{model_id}/versions": lambda: data.VERSIONS,
        "runs": lambda: {"items": service.runs, "next": None},
    }


def add_session(app: FastAPI, service: ScriptedService) -> None:
    @app.get(f"{API}/session")
    def session() -> dict[str, Any]:
        name, role = service.user or (None, None)
        return {"log_in_required": service.log_in_required, "name": name, "role": role}

    @app.post(f"{API}/session")
    async def log_in(request: Request) -> Any:
        given = await request.json()
        assert given["cookie"] is True
        if given["password"] != "right":
            return problem(401, "wrong-password", "The log-in is refused", "", "")
        service.user = given["name"], given["name"]
        return session()

    @app.delete(f"{API}/session", status_code=204)
    def log_out() -> None:
        service.user = None


def add_jobs(app: FastAPI, service: ScriptedService) -> None:
    @app.get(f"{API}/jobs")
    def jobs(limit: int = 50, state: Annotated[list[str], Query()] = []) -> Any:  # noqa: B006
        known = [j for j in service.jobs.values() if not state or j["state"] in state]
        newest = sorted(known, key=lambda j: j["created"], reverse=True)
        return {"items": newest[:limit], "next": None}

    @app.post(f"{API}/jobs", status_code=202)
    async def create(request: Request) -> Any:
        order = await service.note(request)
        names = ("run_id", "target_um", "monte_carlo")
        known = {name: order.get(name) for name in names}
        return service.new_job(order["kind"], **known)

    @app.post(f"{API}/plans", status_code=202)
    async def create_plan(request: Request) -> Any:
        await service.note(request)
        return service.planned | {"state": "queued"}

    @app.patch(f"{API}/jobs/{{job_id}}")
    async def rename(job_id: str, request: Request) -> Any:
        service.jobs[job_id].update(await request.json())
        return service.jobs[job_id]

    @app.post(f"{API}/runs", status_code=201)
    async def upload(bundle: UploadFile) -> Any:
        service.requests.append(("POST", "/runs", bundle.filename))
        return service.add_run("run-uploaded")


def download(content: str, name: str, media_type: str) -> Response:
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    return Response(content, media_type=media_type, headers=headers)


def add_results(app: FastAPI, service: ScriptedService) -> None:
    @app.post(f"{API}/jobs/{{job_id}}/compensations", status_code=201)
    async def compensate(job_id: str, request: Request) -> Any:
        order = await service.note(request)
        if order["unmeasured"] == "refuse":
            said = "X not measured from 450 to 500 mm; measure there"
            return problem(422, "bad-input", "The input cannot be used", said, "")
        made = data.compensation(job_id, order["format"], order["unmeasured"])
        made |= service.rotary_account
        service.compensations.setdefault(job_id, []).append(made)
        return made

    @app.post(f"{API}/jobs/{{job_id}}/certificates", status_code=201)
    async def issue(job_id: str, request: Request) -> Any:
        order = await service.note(request)
        kept = service.certificates.setdefault(job_id, [])
        kept.append(data.certificate(job_id, len(kept) + 1, order["language"]))
        return kept[-1]

    @app.post(f"{API}/jobs/{{job_id}}/certificates/preview")
    async def preview(job_id: str, request: Request) -> Any:
        order = await service.note(request)
        return {"html": f"<h1>PREVIEW</h1>{order['identity']['operator']}"}

    @app.get(f"{API}/jobs/{{job_id}}/result/volumetric-error")
    def size(job_id: str, tolerance_um: float | None = None) -> Any:
        service.looks.append(("volumetric-error", tolerance_um))
        return {"tolerance_um": tolerance_um, **service.conformity}

    @app.put(f"{API}/runs/{{run_id}}/known-lengths")
    def store_known_lengths(run_id: str, known_lengths: UploadFile) -> Any:
        sent = known_lengths.file.read()
        path = f"/runs/{run_id}/known-lengths"
        service.requests.append(("PUT", path, known_lengths.filename))
        if not sent.startswith(b"x1_mm"):
            said = "known_lengths.csv, row 2, column u_mm: is 0"
            return problem(422, "bundle", "The file cannot be read", said, "Correct it")
        return {"count": sent.count(b"\n") - 1}

    @app.post(f"{API}/jobs/{{job_id}}/comparisons", status_code=201)
    def compare(
        job_id: str, reference: UploadFile, reference_um: float, reference_urad: float
    ) -> Any:
        sent = (reference.filename, reference_um, reference_urad)
        service.requests.append(("POST", f"/jobs/{job_id}/comparisons", sent))
        if not reference.file.read().startswith(b"error,"):
            said = f"{reference.filename}, row 1: the column error is missing"
            return problem(422, "bad-bundle", "The file cannot be read", said, "Add it")
        return service.comparison


def add_machines(app: FastAPI, service: ScriptedService) -> None:
    none = {"job_id": None, "compensation_id": None, "files": []}
    tables = f"{API}/machines/{{machine_id}}/simulated-tables"

    def find(machine_id: str) -> dict[str, Any]:
        return next(one for one in service.machines if one["id"] == machine_id)

    @app.get(tables)
    def simulated_tables(machine_id: str) -> Any:
        return {"machine": machine_id, **none, **service.loaded_tables}

    @app.put(tables)
    async def load_simulated_tables(machine_id: str, request: Request) -> Any:
        service.loaded_tables = await request.json()
        return simulated_tables(machine_id)

    @app.delete(tables, status_code=204)
    def clear_simulated_tables() -> None:
        service.loaded_tables = {}

    @app.post(f"{API}/machines", status_code=201)
    async def add_machine(request: Request) -> Any:
        new = await service.note(request)
        if new["id"] in {one["id"] for one in service.machines}:
            return problem(409, "machine-known", "Known", new["id"], "Choose another.")
        name, file = new["machine_file"]["name"], new["machine_file"]
        own = {"origin": "catalogue", "cell": "none", "connected": False}
        entry = data.machine_entry(new["id"], name=name, machine_file=file, **own)
        service.machines.append(entry)
        return entry

    @app.put(f"{API}/machines/{{machine_id}}/machine-file")
    @app.patch(f"{API}/machines/{{machine_id}}")
    async def change_machine(machine_id: str, request: Request) -> Any:
        find(machine_id).update(await service.note(request))
        return find(machine_id)

    @app.put(f"{API}/machines/{{machine_id}}/devices")
    async def set_devices(machine_id: str, request: Request) -> Any:
        find(machine_id)["devices"] = await service.note(request)
        return find(machine_id)

    @app.get(f"{API}/machines/{{machine_id}}")
    def machine_record(machine_id: str) -> Any:
        found = find(machine_id)
        known = {"machine_file": service.machine, "connected": service.connected}
        return known | found if found["origin"] == "catalogue" else found | known

    @app.delete(f"{API}/machines/{{machine_id}}", status_code=204)
    def remove_machine(machine_id: str, request: Request) -> Response:
        version = request.headers.get("if-match")
        service.requests.append(("DELETE", f"/machines/{machine_id}", version))
        if machine_id == service.held_machine:
            said = "job-7 (running) holds the machine"
            return problem(409, "busy", "Busy", said, "Wait.")
        service.machines = [m for m in service.machines if m["id"] != machine_id]
        return Response(status_code=204)

    @app.post(f"{API}/machines/{{machine_id}}/devices:try")
    def try_devices() -> Any:
        return data.EXAMPLES["try_machine_devices"]

    @app.post(f"{API}/machines/{{machine_id}}:connect")
    def connect(machine_id: str) -> Any:
        service.requests.append(("POST", f"/machines/{machine_id}:connect", None))
        if service.refuse_connect:
            said = "The tracker's port is answered by a barcode reader."
            remedy = "Check the cable, then connect again."
            return problem(409, "wrong-device", "Another device answers", said, remedy)
        service.connected = True
        return data.DEVICES

    @app.get(f"{API}/machines/{{machine_id}}/changes")
    def changes(machine_id: str, since: str, until: str) -> Any:
        service.looks.append(("changes", f"{machine_id} {since} {until}"))
        return service.changes

    @app.get(f"{API}/machines/{{machine_id}}/temperature")
    def temperature(machine_id: str) -> Any:
        service.looks.append(("temperature", machine_id))
        if not service.temperature:
            said = service.temperature_refusal
            return problem(422, "bad-input", "The input cannot be used", said, "")
        return service.temperature


def add_motion(app: FastAPI, service: ScriptedService) -> None:
    def refuse() -> Response:
        held = {"controller": service.controller}
        said = f"{service.controller} has this job under control; ask"
        return problem(409, "not-in-control", "Somebody else", said, "Ask", **held)

    @app.post(f"{API}/jobs/{{job_id}}/arming")
    def prepare_arming(job_id: str) -> Any:
        if service.controller:
            return refuse()
        known = {"job": job_id, "token": f"for {job_id}"}
        return data.EXAMPLES["prepare_arming"] | known

    @app.post(f"{API}/jobs/{{job_id}}/{{verb}}", status_code=202)
    async def act(job_id: str, verb: str, request: Request) -> Any:
        if verb == "arm":
            assert await request.json() == {"token": f"for {job_id}"}
        version = request.headers.get("if-match")
        query = f"?{request.url.query}" if request.url.query else ""
        service.requests.append(("POST", f"/jobs/{job_id}/{verb}{query}", version))
        if verb == "take-control":
            service.controller = None
        elif verb in ("arm", "resume") and service.controller:
            return refuse()
        return await run_in_threadpool(service.act, job_id, verb)

    @app.post(f"{API}/stop", status_code=202)
    def stop() -> Any:
        service.stops += 1
        return stopped(service.stop())

    @app.post(f"{API}/stop:check")
    def check_stop() -> Any:
        return stopped([])

    @app.websocket(f"{API}/stop")
    async def stop_by_message(socket: WebSocket) -> None:
        await socket.accept()
        with suppress(WebSocketDisconnect):
            while not service.closing.is_set():
                jobs = [] if await socket.receive_text() == "check" else service.stop()
                await socket.send_json(stopped(jobs))

    def stopped(jobs: list[dict[str, Any]]) -> Any:
        known = service.user or not service.log_in_required
        machines = [{"machine": "default", "stopped": service.stopped, "says": ""}]
        return {"jobs": jobs if known else [], "machines": machines}

    @app.websocket(f"{API}/events")
    async def events(socket: WebSocket) -> None:
        await socket.accept()
        with suppress(WebSocketDisconnect, RuntimeError):
            async for text in service.events():
                await socket.send_text(text)
            await socket.close()

"""Examples in the OpenAPI document: one of every answer and of every request body.

`examples.json` holds answers of the service to its simulated devices, shortened; jobs
are made from their record, so that they follow it.
"""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

from truepath.app.api.job_description import describe_job
from truepath.app.api.models.base import JOB_ID, OTHER_ID
from truepath.app.jobs.job import Job, JobKind, Progress, Stage
from truepath.app.jobs.transitions import State

_JSON = "application/json"
_STANDING = {"machine": "bench-2", "stopped": "true"}
_ENDING = {"machine": "default", "stopped": "unknown"}
_TEXTS = {
    "download_error_tables": "error,position_mm,value,uncertainty,unit,extrapolated,"
    "verdict\nEXX,0.0000,0.00000,0.00000,um,0,usable\n",
    "get_report": "<!doctype html><title>Calibration</title>…",
    "get_discovery_report": "<!doctype html><title>Discovery</title>…",
    "get_verification_report": "<!doctype html><title>Verification</title>…",
    "get_certificate_page": "<!doctype html><title>Certificate</title>…",
    "get_certificate_pdf": "%PDF-1.7…",
    "get_comparison_report": "<!doctype html><title>Comparison</title>…",
    "get_trend_report": "<!doctype html><title>Machine over time</title>…",
    "download_nc_program": "0 BEGIN PGM TRUEPATH MM\n…\n9 END PGM TRUEPATH MM\n",
    "download_plan_nc_program": "0 BEGIN PGM TRUEPATH MM\n…\n9 END PGM TRUEPATH MM\n",
    "download_compensation_file": "0.0 0.0000 0.0000\n10.0 0.0012 0.0015\n",
    "download_bundle": "PK…",
    "download_compensation": "PK…",
}
_FORMS = {
    "upload_bundle": {"bundle": "PK…"},
    "create_comparison": {
        "reference": "error,position_mm,direction,value,unit\nEXX,100,+,1.5,um\n"
    },
}


def add_examples(document: dict[str, Any]) -> None:
    """Give every answer that succeeds, and every request body, an example."""
    answers = _read_answers()
    for operations in document["paths"].values():
        for operation in operations.values():
            name = operation["operationId"]
            for response in operation["responses"].values():
                for media_type, content in response.get("content", {}).items():
                    kept = answers if media_type == _JSON else _TEXTS
                    if name in kept:
                        content["example"] = kept[name]
            body = operation.get("requestBody", {}).get("content", {})
            if "multipart/form-data" in body:
                body["multipart/form-data"]["example"] = _FORMS[name]


def _read_answers() -> dict[str, Any]:
    text = files("truepath.app.api").joinpath("examples.json").read_text("utf-8")
    kept = json.loads(text)
    ready, running = _make_job(State.READY), _make_job(State.RUNNING)
    pausing, resuming = _make_job(State.PAUSING), _make_job(State.RESUMING)
    aborting = _make_job(State.ABORTING)
    return {
        **kept,
        "get_reanalysed_run": kept["get_result"],
        "set_machine_file": kept["set_machine_devices"],
        "create_job": _make_job(State.QUEUED),
        "list_jobs": {"items": [ready], "next": "czoxMg=="},
        "get_job": ready,
        "rename_job": _make_job(State.READY, name="As found"),
        "arm_job": running,
        "pause_job": pausing,
        "resume_job": resuming,
        "cancel_job": _make_job(State.CANCELLING),
        "acknowledge_job": _make_job(State.PREPARING),
        "abort_job": aborting,
        "take_control": ready,
        "stop_motion": {"jobs": [aborting], "machines": [_STANDING, _ENDING]},
        "stop_machine": {"jobs": [aborting], "machines": [_ENDING]},
        "check_stop": {"jobs": [], "machines": [_STANDING, _ENDING]},
        "check_stop_of_machine": {"jobs": [], "machines": [_STANDING]},
    }


def _make_job(state: State, name: str = "") -> dict[str, Any]:
    """Return a job that measures on the fly, as clients see it."""
    moves = state not in (State.QUEUED, State.PREPARING, State.READY)
    job = Job(
        JobKind.MEASURE_OTF,
        id=JOB_ID,
        state=state,
        desired_state=str(State.READY),
        version=3,
        stage=Stage.MEASURING if moves else Stage.WAITING,
        created="2026-05-04T09:30:00.000Z",
        started="2026-05-04T09:31:00.000Z" if moves else None,
        run_id=OTHER_ID if moves else None,
        progress=Progress(4, 22, "lines", 62.5, 14.0, (100.0, 50.0, 20.0)),
        owner="anna",
        name=name,
    )
    return describe_job(job).model_dump(mode="json", by_alias=True)

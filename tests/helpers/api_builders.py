"""What tests of several files do to calibrations and their answers."""

import json
from contextlib import contextmanager

from truepath.catalogue.job import Job, JobKind
from truepath.catalogue.transitions import State

FOREIGN = (  # headers of a page of another site
    {"sec-fetch-site": "cross-site"},
    {"sec-fetch-site": "same-site"},
    {"origin": "http://evil.example"},
    {"origin": "null"},
)
KNOWN_LENGTHS = (
    "x1_mm,y1_mm,z1_mm,x2_mm,y2_mm,z2_mm,length_mm,u_mm\n"
    "1000,0,0,3000.02,0,0,2000.01,0.001\n"
)


def rows_at(*places, **more):
    """Rows of a path at places in mm, each with what more it states."""
    axes = "x_mm", "y_mm", "z_mm"
    return [dict(zip(axes, place, strict=True)) | more for place in places]


@contextmanager
def edited(file):
    content = json.loads(file.read_text())
    yield content
    file.write_text(json.dumps(content))


def set_verdict(service, job_id, state):
    with edited(service.results / job_id / "result.json") as content:
        content["verdict"] = {"state": state, "reasons": ["few lines"], "details": []}


def add_calibration(service, number):
    """Add a job of January that has calibrated the machine; return its identifier."""
    when, known = f"2026-01-0{number}T08:00:00.000Z", {"verdict": "usable"}
    known |= {"state": State.SUCCEEDED, "desired_state": "succeeded"}
    named = {"id": f"job-{number}", "machine": "default"}
    job = Job(JobKind.ANALYSE, created=when, **named, **known)
    service.store.add_recovered(job, None)
    (service.results / job.id).mkdir()
    return job.id


def arm_over_http(client, job):
    """Ask what will move, then arm with the token."""
    address, version = f"/api/v1/jobs/{job['id']}/arm", f'"{job["version"]}"'
    asked = client.post(f"{address}ing")
    assert asked.status_code == 200, asked.text
    token = {"token": asked.json()["token"]}
    return client.post(address, headers={"If-Match": version}, json=token)

"""docs/rest-api.md: every example is sent as it stands, and answered as it says."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from scripted_cell import wait_until

from truepath.catalogue.transitions import FINAL, State
from truepath.jobs.running.plan_orders import plan_measurement

DOCUMENT = Path(__file__).parents[2] / "docs" / "rest-api.md"
TEXT = DOCUMENT.read_text(encoding="utf-8")
BASE = "http://127.0.0.1:8411/api/v1"


def section(heading):
    """Return the curl commands of a section, as lists of words."""
    body = TEXT.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    fences = "".join(re.findall(r"```sh\n(.*?)```", body, re.DOTALL))
    words = shlex.split(fences.replace("\\\n", " "), comments=True)
    starts = [n for n, word in enumerate(words) if word == "curl"]
    ends = [*starts[1:], len(words)]
    return [words[a + 1 : b] for a, b in zip(starts, ends, strict=True)]


def test_the_tables_of_codes_are_those_of_the_service():
    script = DOCUMENT.with_name("write_problem_codes.py")
    checked = subprocess.run([sys.executable, str(script), "--check"], check=False)
    assert checked.returncode == 0, "python docs/write_problem_codes.py writes them"


class Curl:
    """Sends what a curl command line says; the names stand for what was answered."""

    def __init__(self, client, tmp_path):
        self.client, self.folder = client, tmp_path
        self.names = {"$B": "/api/v1", "JOB": "", "RUN": "", "VERSION": ""}

    def __call__(self, words):
        words = [self._filled(word) for word in words]
        method, headers, options, target, output = "GET", {}, {}, "", None
        rest = iter(words)
        for word in rest:
            match word:
                case "-i" | "-N":
                    pass
                case "-X":
                    method = next(rest)
                case "-H":
                    name, _, value = next(rest).partition(": ")
                    headers[name] = value
                case "-d":
                    options["content"] = next(rest)
                case "-F":
                    name, _, file = next(rest).partition("=@")
                    content = (self.folder / file).read_bytes()
                    method, options["files"] = "POST", {name: (file, content)}
                case "-o":
                    output = self.folder / next(rest)
                case _:
                    target = word
        if "/events" in target:
            return self._first_line(target, headers)
        answer = self.client.request(method, target, headers=headers, **options)
        if target.endswith("/arming"):
            self.names["TOKEN"] = answer.json()["token"]
        if output is not None:
            output.write_bytes(answer.content)
        return answer

    def take(self, job):
        self.names |= {"JOB": job["id"], "VERSION": str(job["version"])}
        self.names["RUN"] = job["run_id"] or self.names["RUN"]

    def _filled(self, word):
        for name, value in self.names.items():
            word = word.replace(name, value)
        return word

    def _first_line(self, target, headers):
        with self.client.stream("GET", target, headers=headers) as answer:
            next(answer.iter_lines())
            return answer


@pytest.fixture
def planner():
    """The real one."""
    return plan_measurement


@pytest.fixture
def curl(live, tmp_path):
    return Curl(live, tmp_path)


@pytest.fixture
def follow(curl):
    """Wait until the job is in a state; take its version and its Run."""

    def wait(state):
        def reached():
            job = curl.client.get(f"/api/v1/jobs/{curl.names['JOB']}").json()
            return job if job["state"] == state else None

        curl.take(wait_until(reached, state))

    return wait


def test_the_address_of_the_examples_is_the_default():
    assert f"B={BASE}\n" in TEXT


def test_a_machine_is_measured_and_its_result_taken_away(
    curl, follow, make_cell, tmp_path
):
    connect, create, plan, look, show, arm, again, *own_rows = section(
        "Measure a machine"
    )
    assert curl(connect).json()["connected"]
    answer = curl(create)
    assert answer.status_code == 202
    curl.take(answer.json())
    follow("ready")
    assert len(curl(plan).json()["position"]) > 2
    assert curl(look).headers["etag"] == f'"{curl.names["VERSION"]}"'
    assert curl(show).status_code == 200
    assert curl(arm).status_code == 202
    assert curl(again).json()["state"] == "running"
    assert make_cell.cell.begun.wait(5)
    make_cell.cell.end()
    follow("succeeded")
    for words in section("Take the result away"):
        assert curl(words).status_code == 200, words
    for name in ("error_tables.csv", "report.html", "run.zip"):
        assert (tmp_path / name).stat().st_size > 0
    for words in section("Follow what happens"):
        assert curl(words).status_code == 200, words
    for words in own_rows:
        answer = curl(words)
        assert answer.status_code == 202, answer.text
        curl.take(answer.json())
        follow("ready")
        curl.client.post("/api/v1/stop")
        follow("aborted")


def test_a_path_is_taken_away_as_a_program(curl, follow, tmp_path):
    create = section("Measure a machine")[1]
    curl.take(curl(create).json())
    follow("ready")
    offered, download = section("Without a link to the CNC")
    assert len(curl(offered).json()["items"]) >= 4
    assert curl(download).status_code == 200
    assert (tmp_path / "path.h").read_text().startswith("0 BEGIN PGM ")
    curl.client.post("/api/v1/stop")
    follow("aborted")


def test_a_plan_is_made_looked_at_and_driven(curl, follow, tmp_path):
    create, look, curve, download, drive, validate = section("Plan lines or points")
    answer = curl(create)
    assert answer.status_code == 202
    curl.names |= {"JOB": answer.json()["id"], "PLAN": answer.json()["id"]}
    follow("succeeded")
    assert curl(look).json()["document"]["predicted"]["errors"]
    assert curl(curve).json()["points"]
    assert curl(download).status_code == 200
    assert (tmp_path / "plan.h").read_text().startswith("0 BEGIN PGM ")
    answer = curl(drive)
    assert answer.status_code == 202, answer.text
    curl.take(answer.json())
    follow("ready")
    checked = curl(validate).json()
    assert (checked["rows"], checked["stays_open"]) == (4, "")
    curl.client.post("/api/v1/stop")
    follow("aborted")


def test_motion_is_held_and_stopped(curl, follow, make_cell):
    _, create, _, _, show, arm, *_ = section("Measure a machine")
    stop, abort, pause, resume, cancel = section("Stop, hold, go on")
    curl.take(curl(create).json())
    follow("ready")
    curl(show)
    curl(arm)
    assert make_cell.cell.begun.wait(5)
    follow("running")
    assert curl(pause).status_code == 202
    follow("paused")
    assert curl(resume).status_code == 202
    follow("running")
    assert curl(abort).status_code == 202
    follow("aborted")
    assert curl(stop).status_code == 202
    assert curl(cancel).json()["state"] == "aborted"  # it has ended


def test_a_measurement_ends_at_its_target(curl, follow, make_cell, estimates):
    create, estimate = section("End at a target")
    answer = curl(create)
    assert answer.status_code == 202
    curl.take(answer.json())
    follow("ready")
    for words in section("Measure a machine")[4:6]:
        curl(words)
    assert make_cell.cell.begun.wait(5)
    estimates[-1].publish(1.42, done=9, total=22)
    follow("succeeded")
    assert "course" in curl(estimate).json()
    job = curl.client.get(f"/api/v1/jobs/{curl.names['JOB']}").json()
    assert f"`{json.dumps(job['early_end'])}`" in TEXT


def test_an_adaptive_measurement_is_prepared(curl, follow):
    (create,) = section("Plan while measuring")
    answer = curl(create)
    assert answer.status_code == 202, answer.text
    curl.take(answer.json())
    follow("ready")
    curl.client.post("/api/v1/stop")
    follow("aborted")


def test_a_measurement_from_elsewhere_is_analysed(curl, follow, bundle, tmp_path):
    (tmp_path / "run.zip").write_bytes(bundle())
    upload, *analyses = section("Analyse a measurement from elsewhere")
    for name in ("OTHER", "RUN"):
        answer = curl(upload)
        assert answer.status_code == 201
        curl.names[name] = answer.json()["id"]
    assert len(analyses) == 2
    for analyse in analyses:
        answer = curl(analyse)
        assert answer.status_code == 202
        curl.take(answer.json())
        follow("succeeded")
    job = curl.client.get(f"/api/v1/jobs/{curl.names['JOB']}").json()
    assert job["run_ids"] == [curl.names["RUN"], curl.names["OTHER"]]


def test_a_result_is_taken_to_the_controller(
    curl, follow, service, bundle, analysed, tmp_path
):
    (tmp_path / "run.zip").write_bytes(bundle())
    upload, create, *_ = section("Analyse a measurement from elsewhere")
    curl.names["RUN"] = curl(upload).json()["id"]
    curl.take(curl(create).json())
    follow("succeeded")
    result = service.results / curl.names["JOB"] / "result.json"
    shutil.copyfile(analysed / "result.json", result)
    formats, make, look, *downloads = section("Correct the controller")
    assert curl(formats).status_code == 200
    made = curl(make)
    assert made.status_code == 201
    assert curl(look).json() == made.json()
    for words in [*downloads, *section("See the volumetric error")]:
        assert curl(words).status_code == 200, words
    assert {"comp-x.tbl", "comp.zip"} <= {file.name for file in tmp_path.iterdir()}


def test_a_discovery_and_its_model_are_taken_away(curl, follow, bundle, tmp_path):
    (tmp_path / "run.zip").write_bytes(bundle())
    upload, *_ = section("Analyse a measurement from elsewhere")
    run = curl(upload).json()["id"]
    create, *rest = section("Discover what the model lacks")
    curl.names["RUN"] = run
    answer = curl(create)
    assert answer.status_code == 202, answer.text
    curl.take(answer.json())
    follow("succeeded")
    for words in rest:
        assert curl(words).status_code == 200, words
    assert (tmp_path / "discovery.html").stat().st_size > 0
    assert (tmp_path / "model.json").stat().st_size > 0


def test_a_model_is_used_by_naming_it(curl, follow, bundle, tmp_path):
    (tmp_path / "run.zip").write_bytes(bundle())
    upload, *_ = section("Analyse a measurement from elsewhere")
    curl.names["RUN"] = curl.names["OTHER"] = curl(upload).json()["id"]
    curl.take(curl(section("Discover what the model lacks")[0]).json())
    follow("succeeded")
    analyse, plan = section("Use a model")
    for words in (analyse, plan):
        assert curl(words).status_code == 202, words


def test_a_machine_is_followed_over_time(curl, follow, bundle, tmp_path):
    upload, *_ = section("Analyse a measurement from elsewhere")
    for name, rows in (("RUN", 100), ("OTHER", 120)):
        stream = "".join(f"{n / 500:.3f},{n},0,0\n" for n in range(rows))
        packed = bundle(tracker_csv="t_s,x_mm,y_mm,z_mm\n" + stream)
        (tmp_path / "run.zip").write_bytes(packed)
        curl.names[name] = curl(upload).json()["id"]
    create, found, report = section("Follow the machine over time")
    answer = curl(create)
    assert answer.status_code == 202, answer.text
    curl.take(answer.json())
    follow("succeeded")
    assert curl(found).json()["schema"] == "trend/1"
    assert curl(report).status_code == 200


def test_the_machine_is_asked_for_extra_lines(
    curl, follow, bundle, tmp_path, explorer, make_cell
):
    explorer.rows = [
        {"x_mm": x, "y_mm": 10.0, "z_mm": 10.0, "feed_mm_min": 6000.0, "dwell_s": 0.35}
        for x in (10.0, 400.0)
    ]
    (tmp_path / "run.zip").write_bytes(bundle())
    upload, *_ = section("Analyse a measurement from elsewhere")
    curl.names["RUN"] = curl(upload).json()["id"]
    curl.take(curl(section("Discover what the model lacks")[0]).json())
    follow("succeeded")
    discovery_id = curl.names["JOB"]
    create, plan, look, show, arm, found = section("Ask the machine")
    answer = curl(create)
    assert answer.status_code == 202, answer.text
    curl.take(answer.json())
    follow("ready")
    assert curl(plan).json()["discovery_id"] == discovery_id
    assert curl(look).headers["etag"] == f'"{curl.names["VERSION"]}"'
    assert curl(show).status_code == 200
    assert curl(arm).status_code == 202
    assert make_cell.cell.begun.wait(5)
    make_cell.cell.end()
    follow("succeeded")
    assert curl(found).json()["schema"] == "discovery/1"


def test_the_example_of_a_refusal_is_what_is_answered(client, order, is_problem):
    example = json.loads(re.findall(r"```json\n(.*?)```", TEXT, re.DOTALL)[0])
    order["path"][1]["y_mm"] = 401
    problem = is_problem(client.post("/api/v1/jobs", json=order), 422, "out-of-travel")
    assert {**problem, "request_id": ""} == {**example, "request_id": ""}


def test_every_state_of_the_document_exists():
    body = TEXT.split("\n## States of a job\n")[1].split("\n## ")[0]
    assert {f"`{state}`" for state in State} <= set(re.findall(r"`[\w-]+`", body))
    ends = set(re.findall(r"^\| `(\w+)` \|", body, re.MULTILINE))
    assert ends == {str(state) for state in FINAL}

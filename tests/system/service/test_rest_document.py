"""docs/rest-api.md: every example is sent as it stands, and answered as it says."""

import json
import re
import runpy
import shlex
import shutil
from pathlib import Path

import pytest

from api_builders import KNOWN_LENGTHS, rows_at
from scripted_cell import wait_until
from truepath.catalogue.transitions import FINAL, State

DOCUMENT = Path(__file__).parents[3] / "docs" / "rest-api.md"
TEXT = DOCUMENT.read_text(encoding="utf-8")


def section(heading):
    body = TEXT.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    fences = "".join(re.findall(r"```sh\n(.*?)```", body, re.DOTALL))
    words = shlex.split(fences.replace("\\\n", " "), comments=True)
    starts = [n for n, word in enumerate(words) if word == "curl"]
    ends = [*starts[1:], len(words)]
    return [words[a + 1 : b] for a, b in zip(starts, ends, strict=True)]


def test_address_states_and_tables_of_codes_are_those_of_the_service():
    assert "B=http://127.0.0.1:8411/api/v1\n" in TEXT
    body = TEXT.split("\n## States of a job\n")[1].split("\n## ")[0]
    assert {f"`{state}`" for state in State} <= set(re.findall(r"`[\w-]+`", body))
    ends = set(re.findall(r"^\| `(\w+)` \|", body, re.MULTILINE))
    assert ends == {str(state) for state in FINAL}
    script = runpy.run_path(str(DOCUMENT.with_name("write_tables.py")))
    assert not script["main"](["codes"], check=True), "docs/write_tables.py"


class Curl:
    """Sends what a curl command line says; the names stand for what was answered."""

    def __init__(self, client, cells, tmp_path):
        self.client, self.cells, self.folder = client, cells, tmp_path
        self.names = {"$B": "/api/v1"}

    def __call__(self, words):
        method, headers, options, target, output = "GET", {}, {}, "", None
        rest = map(self._filled, words)
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
                    method = "POST" if method == "GET" else method
                    options["files"] = {name: (file, content)}
                case "-o":
                    output = self.folder / next(rest)
                case _:
                    target = word
        if "/events" in target:
            with self.client.stream("GET", target, headers=headers) as answer:
                next(answer.iter_lines())
                return answer
        answer = self.client.request(method, target, headers=headers, **options)
        if target.endswith("/arming"):
            self.names["TOKEN"] = answer.json()["token"]
        if output is not None:
            output.write_bytes(answer.content)
        return answer

    def order(self, words, state="succeeded"):
        answer = self(words)
        assert answer.status_code == 202, answer.text
        self.names["JOB"] = answer.json()["id"]
        return self.follow(state)

    def follow(self, state):
        def reached():
            job = self.client.get(f"/api/v1/jobs/{self.names['JOB']}").json()
            return job if job["state"] == state else None

        job = wait_until(reached, state)
        self.names["VERSION"] = str(job["version"])
        self.names |= {"RUN": job["run_id"]} if job["run_id"] else {}
        return job

    def arm(self, look, show, arm):
        assert self(look).headers["etag"] == f'"{self.names["VERSION"]}"'
        assert self(show).status_code == 200
        assert self(arm).status_code == 202
        assert self.cells.cell.begun.wait(5)

    def each(self, commands, status=200):
        for words in commands:
            assert self(words).status_code == status, words

    def stop(self):
        self.client.post("/api/v1/stop")
        self.follow("aborted")

    def _filled(self, word):
        for name, value in self.names.items():
            word = word.replace(name, value)
        return word


@pytest.fixture
def curl(live, make_cell, tmp_path):
    return Curl(live, make_cell, tmp_path)


@pytest.fixture
def sent_in(curl, bundle, tmp_path):
    def sent(**members):
        (tmp_path / "run.zip").write_bytes(bundle(**members))
        answer = curl(section("Analyse a measurement from elsewhere")[0])
        assert answer.status_code == 201
        return answer.json()["id"]

    return sent


def test_a_machine_is_measured_and_its_result_taken_away(curl, tmp_path):
    connect, create, plan, *others = section("Measure a machine")
    look, show, arm, again, *own_rows = others
    assert curl(connect).json()["connected"]
    curl.order(create, "ready")
    assert len(curl(plan).json()["position"]) > 2
    offered, download = section("Without a link to the CNC")
    assert len(curl(offered).json()["items"]) >= 4
    assert curl(download).status_code == 200
    assert (tmp_path / "path.h").read_text().startswith("0 BEGIN PGM ")
    curl.arm(look, show, arm)
    assert curl(again).json()["state"] == "running"
    curl.cells.cell.end()
    curl.follow("succeeded")
    curl.each(section("Take the result away"))
    for name in ("error_tables.csv", "report.html", "run.zip"):
        assert (tmp_path / name).stat().st_size > 0
    curl.each(section("Follow what happens"))
    for words in (*own_rows, *section("Plan while measuring")):
        curl.order(words, "ready")
        curl.stop()


@pytest.fixture
def planner(planner, request):
    """One that gives a real plan where a test asks for it."""
    if "short_plan" not in request.fixturenames:
        return planner
    made = request.getfixturevalue("short_plan")
    return lambda machine, order, *, on_progress: made


def test_a_plan_is_made_looked_at_and_driven(curl, tmp_path, short_plan):
    create, look, curve, download, drive, validate = section("Plan lines or points")
    answer = curl(create)
    assert answer.status_code == 202
    curl.names |= {"JOB": answer.json()["id"], "PLAN": answer.json()["id"]}
    curl.follow("succeeded")
    assert curl(look).json()["document"]["predicted"]["errors"]
    assert curl(curve).json()["points"]
    curl.each([download])
    assert (tmp_path / "plan.h").read_text().startswith("0 BEGIN PGM ")
    curl.order(drive, "ready")
    checked = curl(validate).json()
    assert (checked["rows"], checked["stays_open"]) == (4, "")
    curl.stop()


def test_motion_is_held_and_stopped(curl):
    stop, abort, pause, resume, cancel = section("Stop, hold, go on")
    _, create, _, *arm = section("Measure a machine")[:6]
    curl.order(create, "ready")
    curl.arm(*arm)
    curl.follow("running")
    assert curl(pause).status_code == 202
    curl.follow("paused")
    assert curl(resume).status_code == 202
    curl.follow("running")
    assert curl(abort).status_code == 202
    curl.follow("aborted")
    assert curl(stop).status_code == 202
    assert curl(cancel).json()["state"] == "aborted"  # it has ended


def test_a_measurement_ends_at_its_target(curl, estimates):
    create, estimate = section("End at a target")
    curl.order(create, "ready")
    curl.arm(*section("Measure a machine")[3:6])
    estimates[-1].publish(1.42, done=9, total=22)
    job = curl.follow("succeeded")
    assert "course" in curl(estimate).json()
    assert f"`{json.dumps(job['early_end'])}`" in TEXT


def test_a_measurement_from_elsewhere_is_analysed(curl, sent_in, tmp_path):
    _, alone, lengths, several = section("Analyse a measurement from elsewhere")
    for name in ("OTHER", "RUN"):
        curl.names[name] = sent_in()
    curl.order(alone)
    (tmp_path / "known_lengths.csv").write_text(KNOWN_LENGTHS)
    assert curl(lengths).json() == {"count": 1}
    assert curl.order(several)["run_ids"] == [curl.names["RUN"], curl.names["OTHER"]]


@pytest.mark.usefixtures("few_places")
def test_a_result_goes_to_the_controller(curl, service, sent_in, analysed, tmp_path):
    curl.names["RUN"] = sent_in()
    curl.order(section("Analyse a measurement from elsewhere")[1])
    result = service.results / curl.names["JOB"] / "result.json"
    shutil.copyfile(analysed / "result.json", result)
    formats, make, look, *downloads = section("Correct the controller")
    curl.each([formats])
    made = curl(make)
    assert (made.status_code, made.json()) == (201, curl(look).json())
    curl.each([*downloads, *section("See the volumetric error")])
    assert {"comp-x.tbl", "comp.zip"} <= {file.name for file in tmp_path.iterdir()}


def test_a_machine_is_followed_over_time(curl, sent_in):
    for name, rows in (("RUN", 100), ("OTHER", 120)):
        stream = "".join(f"{n / 500:.3f},{n},0,0\n" for n in range(rows))
        curl.names[name] = sent_in(tracker_csv="t_s,x_mm,y_mm,z_mm\n" + stream)
    create, found, report = section("Follow the machine over time")
    curl.order(create)
    assert curl(found).json()["schema"] == "trend/1"
    assert curl(report).status_code == 200


def test_a_discovery_is_used_and_asks_the_machine(curl, sent_in, explorer, tmp_path):
    places = (10.0, 10.0, 10.0), (400.0, 10.0, 10.0)
    explorer.rows = rows_at(*places, feed_mm_min=6000.0, dwell_s=0.35)
    run = curl.names["RUN"] = curl.names["OTHER"] = sent_in()
    discover, *taken = section("Discover what the model lacks")
    discovery_id = curl.order(discover)["id"]
    curl.each(taken)
    assert (tmp_path / "discovery.html").stat().st_size > 0
    assert json.loads((tmp_path / "model.json").read_text())["version"] == 2
    create, plan, look, show, arm, found = section("Ask the machine")
    curl.order(create, "ready")
    planned = curl(plan).json()
    assert planned["discovery_id"] == discovery_id
    assert planned["position"][1] == [400.0, 10.0, 10.0]
    curl.arm(look, show, arm)
    curl.cells.cell.end()
    job = curl.follow("succeeded")
    answer = curl(found).json()
    assert (answer["schema"], answer["effects"][0]["axis"]) == ("discovery/1", "X")
    assert (job["result"], job["run_ids"]) == (None, [run, job["run_id"]])
    listed = [m["id"] for m in curl.client.get("/api/v1/models").json()["items"]]
    assert listed == [job["id"], discovery_id]
    curl.each(section("Use a model"), 202)


def test_the_example_of_a_refusal_is_what_is_answered(curl):
    example = json.loads(re.findall(r"```json\n(.*?)```", TEXT, re.DOTALL)[0])
    rows = rows_at((10, 10, 10), (400, 401, 200), (100, 350, 50))
    body = {"kind": "measure-otf", "path": rows}
    problem = curl.client.post("/api/v1/jobs", json=body).json()
    assert {**problem, "request_id": ""} == {**example, "request_id": ""}

"""The container image is built, and every service of the compose file runs from it."""

import io
import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from contextlib import contextmanager
from pathlib import Path
from urllib.request import Request, urlopen

import psycopg
import pytest
import yaml

from container_image import USER, build_image
from postgres_server import PostgresServer
from processes import until

pytestmark = pytest.mark.long

LARGEST_MB = 700
JOB_S = 240.0


@pytest.fixture(scope="module")
def image(root, tmp_path_factory):
    if os.geteuid() != 0:
        pytest.skip("an image is built as root")
    folder = tmp_path_factory.mktemp("image")
    try:
        yield build_image(root, folder)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(scope="module")
def compose(root):
    return yaml.safe_load((root / "docker" / "compose.yaml").read_text())["services"]


@pytest.fixture
def volume(tmp_path):
    """A data volume as Docker makes one: it belongs to the image's user."""
    folder = tmp_path / "data"
    folder.mkdir()
    os.chown(folder, USER, USER)
    for above in (tmp_path, *tmp_path.parents):
        if above.stat().st_uid == 0 and above != Path("/tmp"):
            above.chmod(above.stat().st_mode | 0o011)
    return folder


@pytest.fixture
def serve(image, compose, volume, tmp_path, free_port):
    """Run the service of a compose entry; yield a function that asks it."""

    @contextmanager
    def start(name, *words, volumes=(), **environment):
        entry = compose[name]["environment"]
        given = {**entry, "TRUEPATH_PORT": str(free_port), **environment}
        command = ["truepath", "serve", *words]
        mounts = {volume: "/data", **dict(volumes)}
        log = tmp_path / f"{name}.log"
        with image.running(command, given, mounts, log) as running:
            running.wait_until_healthy(health_check(free_port))
            yield lambda path, **body: ask(free_port, path, **body)

    return start


def health_check(port):
    address = f"http://127.0.0.1:{port}/healthz"
    line = f"import urllib.request; urllib.request.urlopen({address!r}, timeout=4)"
    return ["python", "-c", line]


def ask(port, path, **body):
    request = Request(f"http://127.0.0.1:{port}{path}")
    if body:
        request.data = json.dumps(body["json"]).encode()
        request.add_header("Content-Type", "application/json")
    for name, value in body.get("headers", {}).items():
        request.add_header(name, value)
    with urlopen(request, timeout=30) as answer:
        return answer.read()


def wait_for(job, get, *states):
    def reached():
        told = json.loads(get(f"/api/v1/jobs/{job}"))
        assert told["state"] not in ("failed", "faulted", "interrupted"), told
        return told if told["state"] in states else None

    return until(reached, JOB_S)


def find_first_job(get):
    """Return the job that the service takes on by itself."""
    return until(lambda: json.loads(get("/api/v1/jobs"))["items"], JOB_S)[0]


def measure(get):
    job = json.loads(get("/api/v1/jobs", json={"kind": "measure-otf"}))
    ready = wait_for(job["id"], get, "ready")
    version = {"If-Match": f'"{ready["version"]}"'}
    arming = json.loads(get(f"/api/v1/jobs/{job['id']}/arming", json={}))
    token = {"token": arming["token"]}
    get(f"/api/v1/jobs/{job['id']}/arm", json=token, headers=version)
    return wait_for(job["id"], get, "succeeded")


def check_tables(job, get):
    """Error tables stand, the report opens, and the Run comes as a bundle."""
    result = f"/api/v1/jobs/{job['id']}/result"
    assert b"EXX" in get(f"{result}/error-tables.json")
    assert b"EXX" in get(f"{result}/report.html")
    bundle = get(f"/api/v1/runs/{job['run_id']}/bundle")
    assert zipfile.is_zipfile(io.BytesIO(bundle))


@pytest.fixture
def postgres_server():
    """With a password, reached over TCP as in the compose file."""
    server = PostgresServer("pass/word")
    yield server
    server.close()


def test_the_image_is_small(image, root):
    with image.container() as name:
        folder = image.buildah("mount", name)
        listed = subprocess.run(
            [sys.executable, root / "docker" / "list_contents.py", folder],
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        assert int(re.search(r"in all \| (\d+)", listed)[1]) < LARGEST_MB


def test_the_main_job_runs_in_the_image(serve):
    """The service of the compose file, with its simulated devices and sped up."""
    speed = {"TRUEPATH_SIMULATED_SPEED": "10"}
    with serve("truepath", "--simulated", "--measure", **speed) as get:
        job = find_first_job(get)
        check_tables(wait_for(job["id"], get, "succeeded"), get)


def test_the_service_measures_simulators_of_another_container(
    serve, image, compose, root, tmp_path
):
    entry = compose["simulators"]
    bench = compose["truepath-bench"]["environment"]
    local = {
        name: value.replace('"simulators"', '"127.0.0.1"')
        for name, value in bench.items()
    }
    machine = root / "simulators/truepath_simulators/scenarios" / "demo.json"
    copy = tmp_path / "machine.json"
    shutil.copy(machine, copy)
    copy.chmod(0o644)
    log = tmp_path / "simulators.log"
    command = ["truepath", *entry["command"], "--speed=10"]
    with image.running(command, {}, {}, log) as simulators:
        simulators.wait_until_healthy(entry["healthcheck"]["test"][1:])
        mounts = {copy: "/machine.json"}
        with serve("truepath-bench", volumes=mounts, **local) as get:
            check_tables(measure(get), get)


def test_the_service_keeps_its_catalogue_in_postgresql(
    serve, postgres_server, tmp_path
):
    secret = tmp_path / "database_password"
    secret.write_text(postgres_server.password)
    secret.chmod(0o444)
    environment = {
        "TRUEPATH_DATABASE_URL": postgres_server.url(),
        "TRUEPATH_SIMULATED_SPEED": "10",
    }
    mounts = {secret: "/run/secrets/database_password"}
    options = ("--simulated", "--measure")
    with serve("truepath-postgres", *options, volumes=mounts, **environment) as get:
        job = find_first_job(get)
        wait_for(job["id"], get, "succeeded")
        words = {"password": postgres_server.password}
        address = postgres_server.url().replace("+psycopg", "")
        with psycopg.connect(address, **words) as connection:
            (count,) = connection.execute("SELECT count(*) FROM jobs").fetchone()
        assert count == 1

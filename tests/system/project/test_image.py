"""The container image is built, and every service of the compose file runs from it."""

import io
import os
import re
import shutil
import subprocess
import sys
import time
import zipfile
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx2
import psutil
import psycopg
import pytest
import yaml

from postgres_server import PostgresServer
from processes import until
from service_process import arm, create, follow

BASE = "docker.io/library/python:3.11-slim-bookworm"
USER = 10001
BUILD_S = 600
START_S = 60.0
# As Debian's own slim images are made.
_OPTIONS = (
    "--include=python3,python3-venv,python3-pip,ca-certificates",
    *(f"--dpkgopt=path-exclude=/usr/share/{n}/*" for n in ("doc", "locale", "man")),
)


@dataclass(frozen=True)
class Image:
    folder: Path
    name: str = "localhost/truepath:test"

    def buildah(self, *words):
        how = {"capture_output": True, "text": True, "timeout": BUILD_S}
        done = subprocess.run([*self._buildah, *words], **how)
        assert done.returncode == 0, done.stderr[-4000:]
        return done.stdout.strip()

    @property
    def _buildah(self):
        store = ("--root", self.folder / "store", "--runroot", self.folder / "run")
        return ("buildah", "--storage-driver", "vfs", *store)

    def run_line(self, container, options, command):
        isolation = ["--isolation", "chroot", "--user", f"{USER}:{USER}"]
        return [*self._buildah, "run", *isolation, *options, container, "--", *command]

    @contextmanager
    def container(self):
        name = self.buildah("from", "--pull-never", self.name)
        try:
            yield name
        finally:
            self.buildah("rm", name)

    @contextmanager
    def running(self, command, environment, volumes, log):
        options = [f"--env={name}={value}" for name, value in environment.items()]
        options += [f"--volume={host}:{inside}" for host, inside in volumes.items()]
        with self.container() as name, log.open("w") as output:
            words = self.run_line(name, options, command)
            begun = subprocess.Popen(words, stdout=output, stderr=output)
            process = Running(self, name, begun, command, log)
            try:
                yield process
            finally:
                process.end()


@dataclass(frozen=True)
class Running:
    image: Image
    container: str
    begun: subprocess.Popen
    command: list[str]
    log: Path

    def main_process(self):
        """Return the interpreter of the command, below the processes of buildah.

        The oldest: numbers of processes begin again where they have run out.
        """
        below = psutil.Process(self.begun.pid).children(recursive=True)
        ours = [p for p in below if Path(p.exe()).name.startswith("python")]
        return min(ours, key=lambda process: process.create_time())

    def is_healthy(self, check):
        line = self.image.run_line(self.container, [], check)
        return subprocess.run(line, capture_output=True, timeout=60).returncode == 0

    def wait_until_healthy(self, check):
        end = time.monotonic() + START_S
        while not self.is_healthy(check):
            assert self.begun.poll() is None, self.log.read_text()
            assert time.monotonic() < end, self.log.read_text()

    def end(self):
        """Ask the command to end, as `docker stop` does, and hold it to a clean end."""
        if self.begun.poll() is None:
            self.main_process().terminate()
        assert self.begun.wait(timeout=30) == 0, self.log.read_text()


def _places_of_pip():
    """Files and folders by which pip finds packages here; none with the usual index."""
    debug, listed = (_tell_pip_config(command) for command in ("debug", "list"))
    files = [line.strip() for line in debug.splitlines() if line.endswith(": True")]
    places = [line.removesuffix(", exists: True") for line in files]
    for word in listed.replace("'", " ").split():
        if word.startswith("file://"):  # an index; the packages lie beside it
            places.append(str(Path(word.removeprefix("file://")).parent))
        elif word.startswith("/"):
            places.append(word)
    return sorted({place for place in places if Path(place).exists()})


def _tell_pip_config(command):
    words = [sys.executable, "-m", "pip", "config", command]
    return subprocess.run(words, capture_output=True, text=True, check=True).stdout


pytestmark = pytest.mark.long
JOB_S = 240.0


@pytest.fixture(scope="module")
def image(root, tmp_path_factory):
    if os.geteuid() != 0:
        pytest.skip("an image is built as root")
    folder = tmp_path_factory.mktemp("image")
    try:
        image = Image(folder)
        archive = folder / "base.tar"
        words = ["mmdebstrap", "--variant=minbase", *_OPTIONS, "bookworm", archive]
        made = subprocess.run(words, capture_output=True, text=True, timeout=BUILD_S)
        assert made.returncode == 0, made.stderr
        base = image.buildah("from", "scratch")
        image.buildah("add", base, archive, "/")
        link = ("ln", "-sf", "/usr/bin/python3", "/usr/local/bin/python")
        image.buildah("run", "--isolation", "chroot", base, "--", *link)
        image.buildah("commit", "--rm", base, BASE)
        image.buildah(
            *("bud", "--format", "docker", "--isolation", "chroot", "--pull-never"),
            *(f"--volume={path}:{path}:ro" for path in _places_of_pip()),
            *("--file", root / "docker" / "Dockerfile", "--tag", image.name, root),
        )
        yield image
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
    @contextmanager
    def start(name, *words, volumes=(), **environment):
        entry = compose[name]["environment"]
        given = {**entry, "TRUEPATH_PORT": str(free_port), **environment}
        command = ["truepath", "serve", *words]
        mounts = {volume: "/data", **dict(volumes)}
        log = tmp_path / f"{name}.log"
        with image.running(command, given, mounts, log) as running:
            address = f"http://127.0.0.1:{free_port}"
            ask = f"r.urlopen('{address}/healthz', None, 4)"
            line = f"import urllib.request as r; {ask}"
            running.wait_until_healthy(["python", "-c", line])
            with httpx2.Client(base_url=address, timeout=30.0) as client:
                yield client

    return start


def end_first_job(client):
    first = until(lambda: client.get("/api/v1/jobs").json()["items"], JOB_S)[0]
    return follow(client, first["id"], "succeeded", patience_s=JOB_S)


def check_tables(job, client):
    result = f"/api/v1/jobs/{job['id']}/result"
    assert "EXX" in client.get(f"{result}/error-tables.json").text
    assert "EXX" in client.get(f"{result}/report.html").text
    bundle = client.get(f"/api/v1/runs/{job['run_id']}/bundle").content
    assert zipfile.is_zipfile(io.BytesIO(bundle))


def test_the_image_is_small(image, root):
    with image.container() as name:
        folder = image.buildah("mount", name)
        listed = subprocess.run(
            [sys.executable, root / "docker" / "list_contents.py", folder],
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        assert int(re.search(r"in all \| (\d+)", listed)[1]) < 700


def test_the_main_job_runs_in_the_image(serve):
    """The service of the compose file, with its simulated devices and sped up."""
    speed = {"TRUEPATH_SIMULATED_SPEED": "10"}
    with serve("truepath", "--simulated", "--measure", **speed) as client:
        check_tables(end_first_job(client), client)


def test_another_container_is_measured(serve, image, compose, root, tmp_path):
    entry = compose["simulators"]
    bench = compose["truepath-bench"]["environment"]
    here = '"simulators"', '"127.0.0.1"'
    local = {name: value.replace(*here) for name, value in bench.items()}
    machine = root / "simulators/truepath_simulators/scenarios" / "demo.json"
    copy = tmp_path / "machine.json"
    shutil.copy(machine, copy)
    copy.chmod(0o644)
    log = tmp_path / "simulators.log"
    command = ["truepath", *entry["command"], "--speed=10"]
    with image.running(command, {}, {}, log) as simulators:
        simulators.wait_until_healthy(entry["healthcheck"]["test"][1:])
        mounts = {copy: "/machine.json"}
        with serve("truepath-bench", volumes=mounts, **local) as client:
            job = create(client)
            arm(client, job)
            ended = follow(client, job["id"], "succeeded", patience_s=JOB_S)
            check_tables(ended, client)


def test_the_service_keeps_its_catalogue_in_postgresql(serve, tmp_path, request):
    # With a password, reached over TCP as in the compose file.
    postgres_server = PostgresServer("pass/word")
    request.addfinalizer(postgres_server.close)
    secret = tmp_path / "database_password"
    secret.write_text(postgres_server.password)
    secret.chmod(0o444)
    environment = {"TRUEPATH_SIMULATED_SPEED": "10"}
    environment["TRUEPATH_DATABASE_URL"] = postgres_server.url()
    mounts = {secret: "/run/secrets/database_password"}
    options = ("--simulated", "--measure")
    with serve("truepath-postgres", *options, volumes=mounts, **environment) as client:
        end_first_job(client)
        words = {"password": postgres_server.password}
        address = postgres_server.url().replace("+psycopg", "")
        with psycopg.connect(address, **words) as connection:
            (count,) = connection.execute("SELECT count(*) FROM jobs").fetchone()
        assert count == 1

"""The image of docker/Dockerfile, built and run without a daemon.

Debian's `mmdebstrap` makes the base that the Dockerfile names, since no image registry
is reached; `buildah` builds and runs. An entry of the compose file is carried out as
`buildah run`: its environment, user, command, volumes. The network is the host's.
"""

import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil

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
        """Run a command in a container of its own; end it with SIGTERM."""
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


def build_image(root, folder):
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
    return image


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

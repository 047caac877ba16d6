"""The service as it is delivered: from the wheel, and by the lines of the container."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import zipfile
from contextlib import contextmanager, suppress
from pathlib import Path
from urllib.error import URLError
from urllib.parse import urljoin
from urllib.request import urlopen

from processes import until

START_S = 30.0
MAIN = "from truepath.cli.command import main; main()"


@contextmanager
def running(command, address, folder, **environment):
    # Not measured: the files of an unpacked wheel are nobody's lines.
    foreign = ("TRUEPATH_", "COVERAGE_")
    kept = {k: v for k, v in os.environ.items() if not k.startswith(foreign)}
    with (folder / "log").open("w+") as log:
        how = {"env": kept | environment, "cwd": folder, "stdout": log, "stderr": log}
        service = subprocess.Popen(command, **how)
        with service:
            try:
                wait_until_healthy(service, address, folder / "log")
                yield
            finally:
                service.send_signal(signal.SIGTERM)
    assert service.returncode == 0


def wait_until_healthy(service, address, log):
    def is_healthy():
        assert service.poll() is None, log.read_text()
        with suppress(URLError), urlopen(f"{address}/healthz", timeout=5) as answer:
            return answer.status == 200

    until(is_healthy, START_S)


def fetched(address):
    with urlopen(address, timeout=10) as answer:
        return answer.read()


def test_a_wheel_serves_every_asset(wheel, tmp_path, free_port):
    unpacked, folder = tmp_path / "wheel", tmp_path / "elsewhere"
    folder.mkdir()
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(unpacked)
        names = archive.namelist()
    address = f"http://127.0.0.1:{free_port}"
    environment = {
        "PYTHONPATH": str(unpacked),
        "TRUEPATH_DATA_DIR": str(folder / "data"),
        "TRUEPATH_PORT": str(free_port),
    }
    ask = [sys.executable, "-c", "import truepath; print(truepath.__file__)"]
    given = {"env": os.environ | environment, "cwd": folder, "text": True}
    place = subprocess.check_output(ask, **given).strip()
    assert Path(place).is_relative_to(unpacked)
    command = [sys.executable, "-c", MAIN, "serve"]
    with running(command, address, folder, **environment):
        page = fetched(f"{address}/").decode()
        links = set(re.findall(r'(?:src|href)="([^"#:]+)"', page))
        assert links
        for link in links:
            assert fetched(urljoin(f"{address}/", link)), link
        room = "truepath/service/page/"
        assets = [name for name in names if name.startswith(f"{room}static/")]
        assert assets
        for name in assets:
            assert fetched(f"{address}/{name.removeprefix(room)}"), name
        assert b"swagger-ui" in fetched(f"{address}/docs")


def test_the_lines_of_the_container_start_the_service(root, tmp_path, free_port):
    text = re.sub(r"\\\n\s*", " ", (root / "docker" / "Dockerfile").read_text())

    def instruction(name):
        return re.findall(rf"^{name} (.*)$", text, re.MULTILINE)[-1]

    (tmp_path / "data").mkdir()
    words = json.loads(instruction("ENTRYPOINT")) + json.loads(instruction("CMD"))
    words[0] = str(Path(sys.executable).with_name(words[0]))
    environment = dict(word.split("=", 1) for word in instruction("ENV").split())
    del environment["PATH"]
    environment |= {
        "TRUEPATH_DATA_DIR": str(tmp_path / "data"),
        "TRUEPATH_PORT": str(free_port),
        "TRUEPATH_ALLOW_PLAIN_HTTP": "true",  # as the compose file has it
        "TRUEPATH_LOG_IN": "never",
    }
    check = json.loads(instruction("HEALTHCHECK").partition(" CMD ")[2])
    check = [word.replace(":8411/", f":{free_port}/") for word in check]
    check[0] = sys.executable
    assert subprocess.run(check, capture_output=True).returncode != 0
    with running(words, f"http://127.0.0.1:{free_port}", tmp_path, **environment):
        assert subprocess.run(check, capture_output=True).returncode == 0


def test_make_lists_its_targets(root):
    words = [shutil.which("make"), "--no-print-directory", "help"]
    how = {"capture_output": True, "text": True, "check": True}
    listed = subprocess.run(words, cwd=root, **how)
    assert not listed.stderr, "a rule that make warns about"
    for target in ("run", "test", "test-long", "check", "bench", "setup", "clean"):
        assert re.search(rf"^  make {target} +\w", listed.stdout, re.MULTILINE), target


def test_the_import_contracts_hold(root):
    linter = Path(sys.executable).with_name("lint-imports")
    linted = subprocess.run([linter], cwd=root, capture_output=True, text=True)
    assert linted.returncode == 0, linted.stdout


def test_starting_the_service_loads_no_heavy_library():
    heavy = {"scipy", "matplotlib", "pyarrow.compute"}
    code = f"import sys, truepath.main\nprint(*({heavy} & set(sys.modules)), end='')"
    loaded = subprocess.check_output([sys.executable, "-c", code], text=True)
    assert not loaded, f"import truepath.main loads {loaded}"

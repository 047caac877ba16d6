"""The bridge kit speaks GST/1: both files, over TCP, against our own driver."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import truepath_drivers.tracker.bridge as kit
from tracker_peers import read_samples
from truepath_drivers.conformance.tracker import TRACKER_CHECKS
from truepath_drivers.tracker.streaming.driver import StreamingTracker

FOLDER = Path(kit.__file__).parent


@pytest.fixture(scope="module", params=["c", "python"])
def port(request, tmp_path_factory):
    """Port of the example of each language; the C one is built here."""
    folder = tmp_path_factory.mktemp("bridge")
    copy = shutil.copy(FOLDER / "gst_bridge.py", folder)  # as beside the SDK of a maker
    command = [sys.executable, "-I", "-S", str(copy)]
    if request.param == "c":
        if shutil.which("cc") is None:
            pytest.skip("no C compiler")
        program = folder / "bridge"
        strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O1"]
        build = ["cc", *strict, "-o", str(program), str(FOLDER / "example.c"), "-lm"]
        subprocess.run(build, check=True)
        command = [str(program)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        yield int(process.stdout.readline())
        process.kill()


def read_whole(port: int, rate_hz: float, count: int, pause_s: float = 0.0):
    """Return so many samples, none of which is missing or was hit on the way."""
    with StreamingTracker(port, host="127.0.0.1") as tracker:
        tracker.start(rate_hz)
        samples, health = read_samples(tracker, count, pause_s), tracker.health
    assert (np.diff(samples.sequence) == 1).all()
    np.testing.assert_allclose(np.diff(samples.device_time_s), 1 / rate_hz, atol=1e-6)
    assert (health.crc_errors, health.skipped_bytes) == (0, 0)
    return samples


def test_samples_of_a_bridge_are_those_of_its_sdk(port):
    away = read_whole(port, 500.0, 300).position_mm - [2000.0, 0.0, 300.0]
    np.testing.assert_allclose(np.hypot(away[:, 0], away[:, 1]), 100.0, atol=1e-6)
    np.testing.assert_allclose(away[:, 2], 0.0, atol=1e-6)


@pytest.mark.parametrize("check", TRACKER_CHECKS)
def test_a_bridge_conforms(port, check):
    check(lambda: StreamingTracker(port, host="127.0.0.1"))


STRICT = ["-Wall", "-Wextra", "-Werror", "-pedantic", "-g"]
SANE = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]


@pytest.mark.long
@pytest.mark.parametrize(
    "compiler", ["gcc -std=c99 -Wconversion", "clang -std=c99", "g++ -std=c++17 -x c++"]
)
def test_the_header_survives_random_bytes_and_odd_frames(compiler, tmp_path):
    name, *flags = compiler.split()
    if shutil.which(name) is None:
        pytest.skip(f"no {name}")
    source, program = Path(__file__).parent / "bridge_attack.c", tmp_path / "attack"
    build = [name, *STRICT, *SANE, *flags, f"-I{FOLDER}", "-o", str(program)]
    subprocess.run([*build, str(source), "-lm"], check=True)
    found = subprocess.run([program], capture_output=True, text=True, check=True)
    assert 240 < int(found.stdout) <= 1024


@pytest.mark.long
def test_fifteen_seconds_at_1_khz_lose_nothing(port):
    read_whole(port, 1000.0, 15_000, pause_s=0.1)

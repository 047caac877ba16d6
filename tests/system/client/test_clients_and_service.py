"""The examples of docs/clients.md with the real service and simulated devices."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from playwright.sync_api import sync_playwright

from service_process import process
from truepath.client import Client

GUIDE = (Path(__file__).parents[3] / "docs" / "clients.md").read_text("utf-8")
ADDRESS = "http://127.0.0.1:8411"


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    with process(tmp_path_factory.mktemp("service")) as (_, client):
        yield str(client.base_url).rstrip("/")


def read_example(language):
    (example,) = re.findall(rf"```{language}\n(.*?)```", GUIDE, re.DOTALL)
    return example


@pytest.mark.long
@pytest.mark.timeout(240)
def test_the_python_example_calibrates_a_machine(address):
    program = read_example("python").replace(ADDRESS, address)
    assert len(program.splitlines()) <= 22
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=200
    )
    assert done.returncode == 0, done.stderr
    *progress, verdict, table = done.stdout.splitlines()
    assert progress[0].startswith("measuring")
    assert verdict.split()[0] in ("usable", "doubtful")
    assert "position_mm" in table
    with Client(address) as client:
        (job,) = client.list_jobs(state=["succeeded"])
        assert job["health"]["samples"] > 5000
        assert client.download(job["result"]["error_tables_csv"]).startswith(b"error,")


@pytest.mark.long
@pytest.mark.ui
@pytest.mark.timeout(240)
def test_the_example_of_a_page_calibrates_a_machine(address):
    found = os.environ.get("CHROMIUM") or shutil.which("chromium")
    assert found, "Chromium is missing: apt-get install chromium, or set CHROMIUM"
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found)
        page = browser.new_page()
        page.goto(f"{address}/docs")
        page.set_default_timeout(200_000)
        said = page.evaluate(
            f"""async () => {{
                {read_example("js")}
                const states = [];
                const tables = await calibrate((s) => states.push(s), () => true);
                return {{ states, tables }};
            }}"""
        )
        browser.close()
    assert {"ready", "running", "succeeded"} <= set(said["states"])
    assert said["tables"]["schema"] == "error-tables/1"
    assert len(said["tables"]["error_tables"]["EXX"]["position_mm"]) > 3

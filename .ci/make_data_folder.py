"""Makes a data folder as the service of today leaves it, for tests of later ones.

python .ci/make_data_folder.py FILE.zip

One Run that was uploaded and analysed, one that was measured here, jobs that have ended
well, by abort and by failure, a user, an API key and an audit log. The report of the
result is left out: nine tenths of it are a library of charts.
"""

import sys
import tempfile
import zipfile
from dataclasses import replace
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent.parent)]
from tests.conftest import _run

from real_services import drive, simulated_service
from service_process import arm, create, follow, moving
from truepath.catalogue.job import Failure, Job, JobKind
from truepath.catalogue.transitions import State
from truepath.files.bundle.bundle import zip_bundle
from truepath.users.access import Access
from truepath.users.audit import Entry
from truepath.users.roles import Role
from truepath_simulators.machine_file import load_machine, parse_machine
from truepath_simulators.motion import paths
from truepath_simulators.worlds import synthetic

PASSWORD = "a password of the fixture"


def make_bundle() -> bytes:
    """Return a standstill Run of a small machine, at a tenth of the usual rate."""
    content = load_machine("demo")
    content["tracker"]["rate_hz"] = 50.0
    for axis in content["axes"].values():
        axis["min_mm"], axis["max_mm"] = 0.0, 120.0
    program = paths.standstill_points(parse_machine(content), 3, 30, dwell_s=0.8)
    return zip_bundle(_run(synthetic.record(content, program, 3, "standstill")))


def fill(folder: Path) -> None:
    with simulated_service(folder, simulated_speed=4.0) as (service, client):
        bundle = {"bundle": ("from the shop floor.zip", make_bundle())}
        run = client.post("/api/v1/runs", files=bundle).json()
        analysed = drive(client, kind="analyse", run_id=run["id"])
        client.post("/api/v1/machines/current:connect")
        job = create(client, kind="measure-standstill")
        arm(client, job)
        moving(client, job["id"])
        client.post(f"/api/v1/jobs/{job['id']}/abort")
        follow(client, job["id"], "aborted")
        plan, _ = service.store.create(Job(JobKind.PLAN))
        failed = {"state": State.FAILED, "failure": Failure("PlanningError", "no time")}
        for change in ({"state": State.RUNNING}, failed):
            service.store.change(plan.id, lambda j, change=change: replace(j, **change))
        add_people(service.access)
    (folder / "results" / analysed["id"] / "report.html").unlink()


def add_people(access: Access) -> None:
    access.accounts.add("ada", Role.ADMINISTRATOR, PASSWORD)
    access.tokens.create_key("gauge-7", Role.SERVICE)
    who, what = ("ada", Role.ADMINISTRATOR, "127.0.0.1"), ("POST /api/v1/jobs", "202")
    for number in range(3):
        made = {"made": f"/api/v1/jobs/{number}"}
        entry = Entry(*who, f"r{number}", *what, old=None, new=made)
        access.audit_writer.record(entry).result(10)


def main() -> None:
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "data"
        fill(folder)
        with zipfile.ZipFile(sys.argv[1], "w", zipfile.ZIP_DEFLATED) as archive:
            for file in sorted(f for f in folder.rglob("*") if f.is_file()):
                archive.write(file, file.relative_to(folder))


if __name__ == "__main__":
    main()

"""Doctor and support bundle tell what helps, disturb nothing and give no secret."""

import json
import socket
import zipfile
from dataclasses import replace
from functools import partial

import pytest

from service_process import process
from truepath.catalogue.database import Database
from truepath.catalogue.job import Failure, Job, JobKind
from truepath.catalogue.locks import hold_folder
from truepath.catalogue.store import Store
from truepath.catalogue.transitions import State
from truepath.cli.command import run
from truepath.operation import doctor, running_service
from truepath.operation.doctor import Grade, check_service
from truepath.operation.running_service import RunningService
from truepath.settings import load_settings
from truepath.users import roles, tls
from truepath.users.accounts import Accounts
from truepath.users.tokens import Tokens
from truepath_simulators.bench.rig import running_rig
from truepath_simulators.machine_file import load_machine

NONE = RunningService(is_there=False)
PLANTED = "planted-5eCret"


@pytest.fixture
def settings(tmp_path, free_port):
    return partial(load_settings, data_dir=tmp_path / "data", port=free_port)


def test_an_installation_in_order_is_found_in_order(capsys, tmp_path):
    status = run(["doctor", "--data-dir", str(tmp_path / "data"), "--json"])
    told = json.loads(capsys.readouterr().out)
    grades = {one["subject"]: one["grade"] for one in told["findings"]}
    assert grades["versions"] == grades["disk"] == grades["catalogue"] == "ok"
    wrong = [one for one in told["findings"] if one["grade"] == "wrong"]
    assert (status, told["good"]) == (int(bool(wrong)), not wrong)
    assert not (tmp_path / "data").exists(), "it was to change nothing"


def test_a_port_that_somebody_has_taken_is_wrong_unless_a_service_answers(settings):
    given = settings()
    with socket.create_server(("127.0.0.1", given.port)):
        found = check_service(given, running_service.find_service(given))
    assert found.grade is Grade.WRONG
    assert str(given.port) in found.text
    assert check_service(given, running_service.find_service(given)).grade is Grade.OK
    for told, words in (({"version": "7.1"}, "version 7.1"), (None, "log-in")):
        found = check_service(given, RunningService(True, True, told))
        assert found.grade is Grade.OK
        assert words in found.text


def test_a_service_that_runs_is_asked_and_keeps_its_devices(settings, monkeypatch):
    given = settings(machine_file=None)
    with hold_folder(given.data_dir):
        running = running_service.find_service(given)
        assert running == RunningService(is_there=True)
        assert check_service(given, running).grade is Grade.WARNING
        asked = []
        monkeypatch.setattr(doctor, "query_device", lambda *a: [asked.append(a)])
        list(doctor.check_devices(given, running))
        assert asked == []


def test_devices_are_named_or_it_is_said_what_to_do(settings, tmp_path, free_port):
    file = tmp_path / "machine.json"
    file.write_text(json.dumps(load_machine("demo")))
    with running_rig({"tracker": "tcp"}) as rig:
        given = settings(
            machine_file=file,
            tracker_options={"host": "127.0.0.1", "port": free_port},
            motion_options=rig.motion_options,
        )
        before = rig.read_position()["position"]
        found = {f.subject: f for f in doctor.check_devices(given, NONE)}
        assert rig.read_position()["position"] == before
    grades = {"machine": Grade.OK, "motion": Grade.OK, "tracker": Grade.WRONG}
    assert {name: found[name].grade for name in grades} == grades
    assert "serial" in found["motion"].text
    assert "cable" in found["tracker"].remedy


@pytest.fixture
def installation(tmp_path):
    """A data folder with users, keys and jobs, its settings and log full of secrets."""
    data = tmp_path / "data"
    data.mkdir()
    database = Database(f"sqlite:///{data / 'catalogue.sqlite'}")
    database.migrate()
    Accounts(database).add("ada", roles.Role.OPERATOR, f"{PLANTED} word")
    token = Tokens(database, session_s=60.0).open_session("ada")
    store = Store(database, lambda _: None)
    job, _ = store.create(Job(JobKind.PLAN))
    failure = Failure("BadInput", f"cannot open http://me:{PLANTED}@camera/")
    store.change(job.id, lambda j: replace(j, state=State.RUNNING))
    store.change(job.id, lambda j: replace(j, state=State.FAILED, failure=failure))
    database.close()
    files = tls.create_certificate(["shop-floor"], data / "tls", 30)
    private = files.key.read_text()
    log = data / "service.log"
    lines = [
        {"event": "as set up", "options": {"password": PLANTED}},
        {"event": f"Authorization: Bearer {token}"},
        {"event": f"key tp_{PLANTED}"},
        {"event": private},
        {"event": f"{PLANTED}-of-tracker is wrong"},
        {"event": "job ended", "job_id": job.id},
    ]
    log.write_text("".join(json.dumps(line) + "\n" for line in lines))
    log.with_name("service.log.1").write_text('{"event": "older"}\n' * 1000)
    config = tmp_path / "truepath.toml"
    config.write_text(
        f'data_dir = "{data}"\n'
        f'log_file = "{log}"\n'
        f'machine_file = "{tmp_path / "none.json"}"\n'
        f'tracker_options = {{ host = "127.0.0.1", port = 9, '
        f'access_code = "1", password = "{PLANTED}-of-tracker" }}\n'
        f'tls_cert = "{files.cert}"\n'
        f'tls_key = "{files.key}"\n'
    )
    secrets = [PLANTED, token, private.splitlines()[1]]
    return config, secrets, job.id


@pytest.fixture
def bundle(tmp_path):
    file = tmp_path / "support.zip"

    def write(*words):
        assert run(["support-bundle", "-o", str(file), *words]) == 0
        assert file.stat().st_mode & 0o077 == 0, "it is for nobody else"
        with zipfile.ZipFile(file) as archive:
            return {name: archive.read(name).decode() for name in archive.namelist()}

    return write


def test_it_holds_what_helps_and_no_secret(installation, bundle, tmp_path, capsys):
    config, secrets, job_id = installation
    parts = bundle("--config", str(config))
    assert "missing: metrics.txt: the service does not run" in capsys.readouterr().err
    names = "versions", "doctor", "catalogue", "jobs", "summary"
    documents = {f"{name}.json" for name in names}
    logs = {"logs/service.log", "logs/service.log.1"}
    assert set(parts) == {"settings.toml", *documents, *logs}
    for name, text in parts.items():
        assert not [s for s in secrets if s in text], name
    (job,) = json.loads(parts["jobs.json"])
    assert job["id"] == job_id
    assert "cannot open" in job["failure"]["detail"]
    assert job_id in parts["logs/service.log"]
    assert json.loads(parts["catalogue.json"])["jobs"] == 1
    assert "numpy" in json.loads(parts["versions.json"])["libraries"]
    # The ends of long logs are kept within the bound.
    log = tmp_path / "data" / "service.log"
    log.write_text('{"event": "early"}\n' + "x" * 3_000_000 + f"\n{job_id}\n")
    (tmp_path / "support.zip").unlink()
    parts = bundle("--config", str(config), "--max-mb", "1")
    assert sum(len(text.encode()) for text in parts.values()) < 1_010_000
    assert "early" not in parts["logs/service.log"]
    assert parts["logs/service.log"].endswith(f"{job_id}\n")


@pytest.mark.long
@pytest.mark.timeout(120)
def test_a_running_service_gives_its_metrics_and_its_log(tmp_path, bundle, monkeypatch):
    log = tmp_path / "logs" / "service.log"
    given = {"TRUEPATH_SIMULATED": "0", "TRUEPATH_LOG_FILE": str(log)}
    with process(tmp_path, **given) as (_, client):
        client.get("/api/v1/system")
        monkeypatch.setenv("TRUEPATH_PORT", str(client.base_url.port))
        monkeypatch.setenv("TRUEPATH_LOG_FILE", str(log))
        parts = bundle("--data-dir", str(tmp_path / "data"))
    assert json.loads(parts["summary.json"])["missing"] == {}
    assert "truepath_catalogue_up 1.0" in parts["metrics.txt"]
    lines = parts["logs/service.log"].splitlines()
    assert all(json.loads(line)["event"] for line in lines)
    assert "catalogue migrated" in parts["logs/service.log"]


def test_a_damaged_catalogue_is_no_hindrance_but_a_file_is(tmp_path, bundle, capsys):
    (tmp_path / "catalogue.sqlite").write_bytes(b"garbage " * 99)
    missing = json.loads(bundle("--data-dir", str(tmp_path))["summary.json"])["missing"]
    assert "is not a SQLite file" in missing["catalogue.json"]
    assert "log_file is not set" in missing["logs"]
    file = tmp_path / "mine.zip"
    file.write_text("mine")
    data = str(tmp_path / "data")
    assert run(["support-bundle", "-o", str(file), "--data-dir", data]) == 2
    assert file.read_text() == "mine"
    assert "is there already" in capsys.readouterr().err

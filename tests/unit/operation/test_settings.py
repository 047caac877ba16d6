"""Settings: where they come from, what is refused, their page, no secret shown."""

import os
import re
import runpy
import tomllib
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import pytest

from truepath.cli.command import run
from truepath.errors import BadInput
from truepath.files.bundle.machine_file import encode_machine
from truepath.jobs.workers.workers import Workers, choose_workers
from truepath.main import _load_machines, open_service
from truepath.operation.settings_text import (
    HIDDEN,
    Redactor,
    list_settings,
    redact_settings,
)
from truepath.settings import Settings, load_settings
from truepath_drivers.interfaces.tracker_records import Light

ROOT = Path(__file__).parents[3]
TOGETHER = {"tls_cert": {"tls_key": "/k.pem"}, "tls_key": {"tls_cert": "/c.pem"}}
PEM = "-----BEGIN EC PRIVATE KEY-----\nMIplanted\n-----END EC PRIVATE KEY-----"


def test_the_page_is_that_of_the_settings():
    script = runpy.run_path(str(ROOT / "docs" / "write_tables.py"))
    assert not script["main"](["settings"], check=True), "docs/write_tables.py"


def test_the_example_says_what_each_setting_means_and_loads(tmp_path, capsys):
    assert run(["settings", "--example"]) == 0
    text = capsys.readouterr().out
    file = tmp_path / "truepath.toml"
    file.write_text(text)
    assert load_settings(file).model_dump() == load_settings().model_dump()
    assert max(map(len, text.splitlines())) < 140
    settings = list(list_settings())
    assert {one.name for one in settings} == set(Settings.model_fields)
    for one in settings:
        assert one.meaning, one.name
        assert one.default or one.example, one.name
        for shown in filter(None, (one.default, one.example)):
            line = f"{one.name} = {shown}\n"
            file.write_text(line)
            loaded = load_settings(file, **TOGETHER.get(one.name, {}))
            dumped = loaded.model_dump(mode="json")[one.name]
            assert dumped == tomllib.loads(line)[one.name], line


def test_the_settings_in_effect_are_toml_that_loads_and_hides_secrets(tmp_path, capsys):
    password = tmp_path / "password"
    password.write_text("planted-one\n")
    file = tmp_path / "truepath.toml"
    file.write_text(
        'database_url = "postgresql+psycopg://me:planted-two@db/x"\n'
        'tracker_options = { host = "h", password = "planted-three" }\n'
        'motion_options = { url = "http://u:planted-four@h/", list = ["a"] }\n'
        f'database_password_file = "{password}"\n'
    )
    assert run(["settings", "--config", str(file)]) == 0
    shown = capsys.readouterr().out
    assert "planted" not in shown
    in_effect = tomllib.loads(shown)
    assert in_effect["tracker_options"] == {"host": "h", "password": HIDDEN}
    assert in_effect["database_password_file"] == str(password)
    assert in_effect["port"] == 8411


@pytest.mark.parametrize(
    "text",
    [
        PEM,
        "a key that is cut -----BEGIN PRIVATE KEY-----\nMIplanted",
        "Authorization: Bearer planted-token-1",
        "cookie truepath_session=planted; path=/",
        "key tp_planted_0123456789abcdef",
        '{"password": "planted word"}',
        "password=planted",
        "DATABASE_PASSWORD: planted",
        "postgresql://me:planted@host/x",
        "hash $argon2id$v=19$m=1$planted",
        "as set up: planted-in-settings",
    ],
)
def test_a_secret_in_a_text_is_hidden(text):
    settings = load_settings(tracker_options={"password": "planted-in-settings"})
    hidden = Redactor(settings).redact(text)
    assert "planted" not in hidden
    assert HIDDEN in hidden


def test_what_is_no_secret_stays():
    text = (
        '{"event": "job ended", "job_id": "019a-17", "path": "/api/v1/jobs/x/arm", '
        '"link": "http://127.0.0.1:8411/docs", "tokens": 3}'
    )
    redacted = Redactor(load_settings()).redact(text)
    assert re.sub(r'"tokens": .*}', "", redacted) == re.sub(r'"tokens": .*}', "", text)
    settings = load_settings(tracker_options={"host": "h", "port": 5000})
    shown = dict(redact_settings(settings))
    assert shown == settings.model_dump(mode="json")


@pytest.fixture(autouse=True)
def nothing_set(monkeypatch, tmp_path):
    for name in list(os.environ):
        if name.startswith("TRUEPATH_"):
            monkeypatch.delenv(name)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))


@pytest.fixture
def toml(tmp_path):
    def write(text, place=tmp_path / "settings.toml"):
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(text)
        return place

    return write


def test_the_defaults_listen_at_home_and_beyond_has_to_be_said(tmp_path):
    settings = load_settings()
    assert (settings.host, settings.port) == ("127.0.0.1", 8411)
    assert settings.data_dir == tmp_path / "data" / "truepath"
    assert settings.database == f"sqlite:///{settings.data_dir}/catalogue.sqlite"
    for host in ("127.0.0.1", "127.8.8.8", "::1", "localhost"):
        assert load_settings(host=host).is_loopback
    assert not load_settings(host="0.0.0.0", allow_plain_http=True).is_loopback


def test_the_command_line_beats_environment_and_file(toml, monkeypatch, tmp_path):
    toml("port = 1001\n", tmp_path / "config" / "truepath" / "truepath.toml")
    assert load_settings().port == 1001  # at its usual place
    monkeypatch.setenv("TRUEPATH_CONFIG", str(toml("port = 1002\n")))
    assert load_settings().port == 1002
    file = toml('port = 1000\nlog_level = "debug"\nsimulated_seed = 3\n')
    monkeypatch.setenv("TRUEPATH_PORT", "2000")
    monkeypatch.setenv("TRUEPATH_LOG_LEVEL", "error")
    settings = load_settings(file, port=3000, simulated=None)
    assert (settings.port, settings.log_level) == (3000, "error")
    assert settings.simulated_seed == 3
    file = toml('[tracker_options]\nport = "/dev/tracker"\nbaudrate = 921600\n')
    monkeypatch.setenv("TRUEPATH_MOTION_OPTIONS", '{"host": "10.0.0.2", "port": 502}')
    settings = load_settings(file)
    assert settings.tracker_options == {"port": "/dev/tracker", "baudrate": 921600}
    assert settings.motion_options == {"host": "10.0.0.2", "port": 502}


WRONG = [
    ('port = "many"', "setting port: Input should be a valid integer"),
    ("prot = 1", "setting prot: Extra inputs are not permitted"),
    ("port = = 1", "settings .*: Invalid value"),
    ('host = "0.0.0.0"', "reached from other computers.*--allow-plain-http"),
    ('host = "mill.example"', "host mill.example can be reached"),
    ("tracker_options = 3\n", "setting tracker_options"),
    ("[tracker_patience_s]\nsilence = 1.0\n", "silence is none of silent, dead"),
    ("[tracker_patience_s]\ndead = 0.0\n", "dead is 0 s, not in 0 to 3600 s"),
    ("[machines.Mill_3]\nmachine_file = 'm.json'\n", "'Mill_3' cannot name"),
    ("[machines.current]\nmachine_file = 'm.json'\n", "'current' cannot name"),
    ("[machines.mill]\n", "setting machines.mill.machine_file: Field required"),
    ("[machines.mill]\nport = 1\n", "setting machines.mill.*: "),
    (
        "machine_file = 'a.json'\n[machines.default]\nmachine_file = 'b.json'\n",
        "two machines of one identifier",
    ),
    ("simulated_machines = 2\n", "simulated_machines needs simulated = true"),
    ("tracker_light = { wavelength_nm = 63.3 }\n", "tracker_light"),
    ("tracker_light = { index = 1 }\n", "tracker_light"),
    ("tracker_light = { is_group = 1 }\n", "tracker_light"),
]


def test_a_setting_that_cannot_be_used_is_named(toml, monkeypatch, tmp_path):
    for text, problem in WRONG:
        with pytest.raises(BadInput, match=problem):
            load_settings(toml(text))
    with pytest.raises(BadInput, match=r"nowhere\.toml: no such settings file"):
        load_settings(tmp_path / "nowhere.toml")
    monkeypatch.setenv("TRUEPATH_TRACKER_OPTIONS", "{port")
    with pytest.raises(BadInput, match='field "tracker_options"'):
        load_settings()


def test_the_password_of_the_catalogue_comes_from_a_file(tmp_path):
    secret = tmp_path / "password"
    url = "postgresql+psycopg://truepath@db/truepath"
    settings = load_settings(database_url=url, database_password_file=secret)
    with pytest.raises(BadInput, match="database_password_file"):
        _ = settings.database
    secret.write_text("p@ss/word\n")
    with_password = "postgresql+psycopg://truepath:p%40ss%2Fword@db/truepath"
    assert settings.database == with_password
    assert "p@ss" not in repr(settings)


def test_who_computes_is_set_like_everything_else(monkeypatch, tmp_path):
    assert choose_workers(load_settings()) == Workers()
    settings = load_settings(data_dir=tmp_path, executor="dask")
    with pytest.raises(BadInput, match="setting dask_scheduler: is empty"):
        open_service(settings).__enter__()
    monkeypatch.setenv("TRUEPATH_EXECUTOR", "dask")
    monkeypatch.setenv("TRUEPATH_DASK_SCHEDULER", "tcp://192.0.2.20:8786")
    monkeypatch.setenv("TRUEPATH_EXECUTOR_WORKERS", "6")
    workers = Workers("dask", 6, "tcp://192.0.2.20:8786")
    assert choose_workers(load_settings()) == workers
    monkeypatch.setenv("TRUEPATH_EXECUTOR", "dask://192.0.2.20:8786")
    monkeypatch.setenv("TRUEPATH_DASK_SCHEDULER", "tcp://192.0.2.21:8786")
    with pytest.raises(BadInput, match="name two schedulers"):
        load_settings()
    monkeypatch.delenv("TRUEPATH_DASK_SCHEDULER")
    assert choose_workers(load_settings()) == workers


def test_patience_light_and_thermometers_reach_their_cell(toml, tmp_path, mill):
    (tmp_path / "mill.json").write_bytes(encode_machine(mill))
    file = toml(f"""
machine_file = "{tmp_path / "mill.json"}"
thermometer_driver = "modbus-registers"
tracker_light = {{ wavelength_nm = 633, is_group = 0 }}

[thermometer_options]
host = "192.0.2.20"

[[thermometer_options.registers]]
name = "X_degC"
address = 3
scale = 0.1

[tracker_patience_s]
point = 60.0
""")
    with ExitStack() as stack:
        config = _load_machines(load_settings(file), stack)[0].config
    assert (config.timeouts.point_s, config.timeouts.dead_s) == (60.0, 5.0)
    assert config.thermometer_driver == "modbus-registers"
    row = config.thermometer_options["registers"][0]
    assert row == {"name": "X_degC", "address": 3, "scale": 0.1}
    assert config.light == Light(633.0, is_group=False, assumed_index=1.0)


def test_several_machines_are_tables_each_with_its_devices(toml, tmp_path, mill):
    for name in ("mill", "lathe"):
        file = tmp_path / f"{name}.json"
        file.write_bytes(encode_machine(replace(mill, name=name)))
    file = toml(f"""
[machines.mill-3]
machine_file = "{tmp_path / "mill.json"}"
tracker_options = {{ port = "/dev/tracker-1" }}
motion_options = {{ host = "192.0.2.3" }}

[machines.lathe]
machine_file = "{tmp_path / "lathe.json"}"
tracker_driver = "geocom"
tracker_options = {{ port = "/dev/tracker-2" }}
motion_options = {{ host = "192.0.2.4" }}
allow_no_watchdog = true
""")
    with ExitStack() as stack:
        mill_3, lathe = _load_machines(load_settings(file), stack)
    assert (mill_3.id, mill_3.machine.name) == ("mill-3", "mill")
    assert (lathe.id, lathe.machine.name) == ("lathe", "lathe")
    assert lathe.config.tracker_driver == "geocom"
    assert not mill_3.config.allow_no_watchdog
    assert lathe.config.allow_no_watchdog

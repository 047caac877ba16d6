from __future__ import annotations

import os
from contextlib import ExitStack
from dataclasses import replace

import pytest

from truepath.errors import BadInput
from truepath.files.bundle.machine_file import encode_machine
from truepath.jobs.workers.workers import Workers, choose_workers
from truepath.main import _load_machines, open_service
from truepath.settings import load_settings
from truepath_drivers.interfaces.tracker_records import Light


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


def test_the_defaults_listen_at_home(tmp_path):
    settings = load_settings()
    assert (settings.host, settings.port) == ("127.0.0.1", 8411)
    assert settings.is_loopback
    assert settings.data_dir == tmp_path / "data" / "truepath"
    assert settings.database == f"sqlite:///{settings.data_dir}/catalogue.sqlite"


def test_the_command_line_beats_the_environment_beats_the_file(toml, monkeypatch):
    file = toml('port = 1000\nlog_level = "debug"\nsimulated_seed = 3\n')
    monkeypatch.setenv("TRUEPATH_PORT", "2000")
    monkeypatch.setenv("TRUEPATH_LOG_LEVEL", "error")
    settings = load_settings(file, port=3000, simulated=None)
    assert (settings.port, settings.log_level, settings.simulated_seed) == (
        3000,
        "error",
        3,
    )


def test_the_file_can_be_named_by_the_environment_or_stand_at_its_usual_place(
    toml, monkeypatch, tmp_path
):
    usual = tmp_path / "config" / "truepath" / "truepath.toml"
    toml("port = 1001\n", usual)
    assert load_settings().port == 1001
    monkeypatch.setenv("TRUEPATH_CONFIG", str(toml("port = 1002\n")))
    assert load_settings().port == 1002


def test_options_of_drivers_are_tables_in_the_file_and_json_in_the_environment(
    toml, monkeypatch
):
    file = toml('[tracker_options]\nport = "/dev/tracker"\nbaudrate = 921600\n')
    monkeypatch.setenv("TRUEPATH_MOTION_OPTIONS", '{"host": "10.0.0.2", "port": 502}')
    settings = load_settings(file)
    assert settings.tracker_options == {"port": "/dev/tracker", "baudrate": 921600}
    assert settings.motion_options == {"host": "10.0.0.2", "port": 502}


def test_patience_with_a_tracker_reaches_its_cell(toml, tmp_path, mill):
    machine = tmp_path / "machine.json"
    machine.write_bytes(encode_machine(mill))
    text = f'machine_file = "{machine}"\n[tracker_patience_s]\npoint = 60.0\n'
    with ExitStack() as stack:
        cell = _load_machines(load_settings(toml(text)), stack)[0].config
    assert cell is not None
    assert (cell.timeouts.point_s, cell.timeouts.dead_s) == (60.0, 5.0)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('port = "many"', "setting port: Input should be a valid integer"),
        ("port = 70000", "setting port: Input should be less than or equal to 65535"),
        ("prot = 1", "setting prot: Extra inputs are not permitted"),
        ("port = = 1", "settings .*: Invalid value"),
        ('host = "0.0.0.0"', "reached from other computers.*--allow-plain-http"),
        ('host = "mill.example"', "host mill.example can be reached"),
        ("simulated_speed = 0", "setting simulated_speed: Input should be greater"),
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
    ],
)
def test_a_setting_that_cannot_be_used_is_named(toml, text, problem):
    with pytest.raises(BadInput, match=problem):
        load_settings(toml(text))


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(BadInput, match=r"nowhere\.toml: no such settings file"):
        load_settings(tmp_path / "nowhere.toml")


def test_a_table_in_the_environment_that_is_no_json_is_named(monkeypatch):
    monkeypatch.setenv("TRUEPATH_TRACKER_OPTIONS", "{port")
    with pytest.raises(BadInput, match='field "tracker_options"'):
        load_settings()


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.8.8", "::1", "localhost"])
def test_loopback_is_this_computer_only(host):
    assert load_settings(host=host).is_loopback


def test_listening_beyond_this_computer_has_to_be_said():
    settings = load_settings(host="0.0.0.0", allow_plain_http=True)
    assert not settings.is_loopback


def test_the_password_of_the_catalogue_comes_from_a_file(tmp_path):
    secret = tmp_path / "password"
    secret.write_text("p@ss/word\n")
    settings = load_settings(
        database_url="postgresql+psycopg://truepath@db/truepath",
        database_password_file=secret,
    )
    assert settings.database == (
        "postgresql+psycopg://truepath:p%40ss%2Fword@db/truepath"
    )
    assert "p@ss" not in repr(settings)


def test_a_password_file_that_is_not_there_is_named(tmp_path):
    settings = load_settings(
        database_url="postgresql+psycopg://truepath@db/truepath",
        database_password_file=tmp_path / "nowhere",
    )
    with pytest.raises(BadInput, match="database_password_file"):
        _ = settings.database


def test_settings_do_not_change():
    with pytest.raises(ValueError, match="frozen"):
        load_settings().port = 1


def test_who_computes_is_set_like_everything_else(monkeypatch):
    assert choose_workers(load_settings()) == Workers()
    monkeypatch.setenv("TRUEPATH_EXECUTOR", "dask")
    monkeypatch.setenv("TRUEPATH_DASK_SCHEDULER", "tcp://192.0.2.20:8786")
    monkeypatch.setenv("TRUEPATH_EXECUTOR_WORKERS", "6")
    assert choose_workers(load_settings()) == Workers(
        "dask", 6, "tcp://192.0.2.20:8786"
    )


def test_a_service_whose_executor_cannot_be_does_not_start(tmp_path):
    settings = load_settings(data_dir=tmp_path, executor="dask")
    with (
        pytest.raises(BadInput, match="setting dask_scheduler: is empty"),
        open_service(settings),
    ):
        pass


def test_thermometers_and_the_light_of_a_tracker_reach_their_cell(toml, tmp_path, mill):
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
""")
    with ExitStack() as stack:
        config = _load_machines(load_settings(file), stack)[0].config
    assert config.thermometer_driver == "modbus-registers"
    row = config.thermometer_options["registers"][0]
    assert row == {"name": "X_degC", "address": 3, "scale": 0.1}
    assert config.light == Light(633.0, is_group=False, assumed_index=1.0)


@pytest.mark.parametrize(
    "light", ["{ wavelength_nm = 63.3 }", "{ index = 1 }", "{ is_group = 1 }"]
)
def test_a_light_that_cannot_be_is_named(toml, light):
    with pytest.raises(BadInput, match="tracker_light"):
        load_settings(toml(f"tracker_light = {light}\n"))


def test_a_dask_address_names_executor_and_scheduler(monkeypatch):
    monkeypatch.setenv("TRUEPATH_EXECUTOR", "dask://192.0.2.20:8786")
    workers = choose_workers(load_settings())
    assert (workers.kind, workers.scheduler) == ("dask", "tcp://192.0.2.20:8786")
    monkeypatch.setenv("TRUEPATH_DASK_SCHEDULER", "tcp://192.0.2.21:8786")
    with pytest.raises(BadInput, match="name two schedulers"):
        load_settings()


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

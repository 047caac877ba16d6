"""Settings as text: the page is current, the example loads, no secret is shown."""

import os
import re
import runpy
import sys
import tomllib
from pathlib import Path

import pytest

from truepath.cli.command import run
from truepath.operation.redaction import HIDDEN, Redactor, redact_settings
from truepath.operation.settings_text import list_settings
from truepath.settings import Settings, load_settings

ROOT = Path(__file__).parents[3]
TOGETHER = {"tls_cert": {"tls_key": "/k.pem"}, "tls_key": {"tls_cert": "/c.pem"}}


@pytest.fixture(autouse=True)
def nothing_set(monkeypatch, tmp_path):
    for name in list(os.environ):
        if name.startswith("TRUEPATH_"):
            monkeypatch.delenv(name)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


def test_the_page_is_that_of_the_settings(monkeypatch):
    script = str(ROOT / "docs" / "write_settings.py")
    monkeypatch.syspath_prepend(ROOT / "docs")
    monkeypatch.setattr(sys, "argv", [script, "--check"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(script, run_name="__main__")
    assert ended.value.code == 0, "python docs/write_settings.py writes it"


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


PEM = "-----BEGIN EC PRIVATE KEY-----\nMIplanted\n-----END EC PRIVATE KEY-----"


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

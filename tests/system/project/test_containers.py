"""The Dockerfile and the compose file as texts.

Linted, validated against the Compose schema, and every name they use (files, settings,
flags, ports) is looked up in the real thing. Their lines run in `test_running.py`; the
image is built and run in `test_image.py`.
"""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import jsonschema
import pytest
import yaml

from truepath.files.bundle.machine_file import read_machine
from truepath.settings import Settings, load_settings

VENDORED = Path(__file__).parent / "vendor" / "compose-spec.json"


@pytest.fixture(scope="module")
def dockerfile(root):
    return (root / "docker" / "Dockerfile").read_text()


@pytest.fixture(scope="module")
def compose(root):
    return yaml.safe_load((root / "docker" / "compose.yaml").read_text())


def instructions(dockerfile, name):
    joined = re.sub(r"\\\n\s*", " ", dockerfile)
    return re.findall(rf"^{name} (.*)$", joined, re.MULTILINE)


def test_the_dockerfile_passes_hadolint(root):
    words = [Path(sys.executable).with_name("hadolint"), "--no-color"]
    file = root / "docker" / "Dockerfile"
    linted = subprocess.run([*words, file], capture_output=True, text=True)
    assert linted.returncode == 0, linted.stdout + linted.stderr


def test_all_that_is_needed_is_copied_from_the_build_context(dockerfile, root):
    ignored = (root / "docker" / "Dockerfile.dockerignore").read_text().split()
    copied = [line.split() for line in instructions(dockerfile, "COPY")]
    sources = [w for words in copied if "--from" not in words[0] for w in words[:-1]]
    assert sources
    for source in sources:
        assert (root / source).exists(), source
        assert f"!{source}" in ignored, f"{source} is kept out of the build context"
    pyproject = tomllib.loads((root / "pyproject.toml").read_text())
    needed = pyproject["tool"]["setuptools"]["packages"]["find"]["where"]
    assert set(needed) <= set(sources)


def environment_of(dockerfile):
    words = " ".join(instructions(dockerfile, "ENV")).split()
    return dict(word.split("=", 1) for word in words)


def test_ports_data_folder_and_user_are_those_of_the_service(dockerfile, compose):
    assert instructions(dockerfile, "USER")[-1] == "10001:10001"
    port = str(Settings.model_fields["port"].default)
    assert instructions(dockerfile, "EXPOSE") == [port]
    assert environment_of(dockerfile)["TRUEPATH_PORT"] == port
    assert f"127.0.0.1:{port}/healthz" in instructions(dockerfile, "HEALTHCHECK")[0]
    for service in compose["services"].values():
        for published in service.get("ports", []):
            assert published == f"127.0.0.1:{port}:{port}"
    (volume,) = instructions(dockerfile, "VOLUME")
    assert environment_of(dockerfile)["TRUEPATH_DATA_DIR"] == volume
    serving = [s for s in compose["services"].values() if s.get("ports")]
    assert serving
    assert all(f"data:{volume}" in service["volumes"] for service in serving)


def test_the_compose_file_is_valid_and_a_mistake_in_it_would_be_seen(compose):
    # Named, since the schema spells its draft with https where jsonschema has http.
    schema = jsonschema.Draft7Validator(json.loads(VENDORED.read_text()))
    schema.validate(compose)
    wrong = {**compose, "services": {"truepath": {"imagine": "truepath"}}}
    with pytest.raises(jsonschema.ValidationError, match="imagine"):
        schema.validate(wrong)


def test_environments_make_good_settings(dockerfile, compose, monkeypatch, tmp_path):
    secret = tmp_path / "database_password"
    secret.write_text("pass/word\n")
    for service in compose["services"].values():
        given = environment_of(dockerfile) | service.get("environment", {})
        ours = {name: v for name, v in given.items() if name.startswith("TRUEPATH_")}
        named = {name.removeprefix("TRUEPATH_").lower() for name in ours}
        assert named <= set(Settings.model_fields)
        if not service.get("ports"):
            continue
        if "TRUEPATH_DATABASE_PASSWORD_FILE" in ours:
            ours["TRUEPATH_DATABASE_PASSWORD_FILE"] = str(secret)
        with monkeypatch.context() as context:
            for name, value in ours.items():
                context.setenv(name, value)
            settings = load_settings()
        assert settings.host == "0.0.0.0"
        if settings.database_url:
            place = "truepath:pass%2Fword@postgres/truepath"
            assert settings.database == f"postgresql+psycopg://{place}"


def test_the_bench_listens_where_the_service_looks_for_it(compose, root):
    simulators = compose["services"]["simulators"]["command"]
    given = dict(word.split("=") for word in simulators if "=" in word)
    service = compose["services"]["truepath-bench"]["environment"]
    tracker = json.loads(service["TRUEPATH_TRACKER_OPTIONS"])
    motion = json.loads(service["TRUEPATH_MOTION_OPTIONS"])
    assert tracker == {"host": "simulators", "port": int(given["--tracker-port"])}
    assert motion["host"] == "simulators"
    assert motion["port"] == int(given["--modbus-port"])
    machine = root / "docker" / compose["configs"]["machine"]["file"]
    assert read_machine(machine).name == "demo"


def test_services_share_profiles_and_keep_secrets_in_files(compose, root):
    for secret in compose["secrets"].values():
        path = Path("docker") / secret["file"]
        ignored = subprocess.run(["git", "check-ignore", "-q", path], cwd=root)
        assert ignored.returncode == 0, f"{path} could be committed"
    assert "PASSWORD:" not in (root / "docker" / "compose.yaml").read_text()
    services = compose["services"]
    for name, service in services.items():
        for other in service.get("depends_on", {}):
            theirs = set(services[other].get("profiles", []))
            assert not theirs or theirs & set(service.get("profiles", [])), name
    pyproject = tomllib.loads((root / "pyproject.toml").read_text())
    version = pyproject["project"]["version"]
    images = {service["image"] for service in services.values() if "build" in service}
    assert images == {f"truepath:{version}"}

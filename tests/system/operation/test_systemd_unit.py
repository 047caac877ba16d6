"""The unit for systemd: systemd finds nothing wrong with it."""

import configparser
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from truepath.cli.command import run


@pytest.fixture
def unit(tmp_path, capsys):
    config = tmp_path / "my settings.toml"
    config.write_text('log_file = "/var/log/truepath/service.log"\n')
    words = ["--config", str(config), "--data-dir", "/srv/true path/100%"]
    assert run(["systemd-unit", *words, "--user", "root"]) == 0
    return capsys.readouterr().out


def test_the_unit_says_what_keeps_the_machine_safe(unit):
    parser = configparser.RawConfigParser(strict=False)
    parser.optionxform = str
    parser.read_string(unit)
    service = parser["Service"]
    assert (service["Type"], service["Restart"]) == ("notify", "on-failure")
    assert service["KillMode"] == "mixed", "the cell is not killed with the service"
    assert float(service["WatchdogSec"]) >= 10
    assert service["ProtectSystem"] == "strict"
    assert service["SupplementaryGroups"] == "dialout"
    assert "OMP_NUM_THREADS=1" in service["Environment"].split()
    assert "'-/srv/true path/100%%'" in service["ReadWritePaths"]
    assert "-/var/log/truepath" in service["ReadWritePaths"]
    command = service["ExecStart"]
    assert command.startswith(str(Path(sys.executable).with_name("truepath")))


@pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="no systemd here")
def test_systemd_finds_nothing_wrong(unit, tmp_path):
    file = tmp_path / "truepath.service"
    file.write_text(unit)
    words = ["systemd-analyze", "verify", "--man=no", str(file)]
    found = subprocess.run(words, capture_output=True, text=True, check=False)
    assert not [line for line in found.stderr.splitlines() if "truepath" in line]
    assert found.returncode == 0, found.stderr


def test_a_user_that_is_no_name_is_refused(capsys):
    assert run(["systemd-unit", "--user", "a\nb"]) == 2
    assert "--user" in capsys.readouterr().err

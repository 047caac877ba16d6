"""One broken plug-in costs nobody else anything, and is named where it is asked for."""

import json
import re

import pytest

from plugin_site import NAME, install
from truepath import plugins
from truepath.cli.command import run
from truepath.device_options import DEVICES
from truepath.errors import BadInput
from truepath.kinematics.effects.family import list_families
from truepath.motion.nc_programs.programs import list_dialects, write_program
from truepath.operation import plugin_list
from truepath.planning.default_path import default_path
from truepath.service.page.pages import catalogue

pytestmark = pytest.mark.fault_row(49)
BROKEN = 'raise RuntimeError("the licence has run out")'
LEAVING = 'import sys; sys.exit("this computer is not known")'
FORMATS = """
    from truepath.compensation.formats.generic import GenericCsv

    class Mute(GenericCsv):
        carries = None
"""
OTHERS = """
    from truepath.kinematics.effects.backlash import BacklashFamily
    from truepath.motion.nc_programs.gcode import LinuxCnc

    class Effect(BacklashFamily):
        name = "hostile"

        def propose(self, at):
            raise RuntimeError("no machine like this")

    class Newer(BacklashFamily):
        name = "newer"
        interface_version = 7

    class Wordless(BacklashFamily):
        words = None

    class Dialect(LinuxCnc):
        def write(self, content):
            raise RuntimeError("no control like this")
"""
GROUPS = "trackers motion_controllers thermometers effects nc_dialects"
POINTS = {
    group: {"broken": "broken:X", "leaving": "leaving:X", "absent": "not_there:X"}
    for group in (*GROUPS.split(), "compensation_formats")
}
POINTS["trackers"] |= {"streaming": "broken:X", "../up": "broken:X"}
POINTS["compensation_formats"] |= {"mute": "formats_here:Mute"}
POINTS["effects"] |= {"hostile": "others:Effect", "wordless": "others:Wordless"}
POINTS["effects"] |= {"newer": "others:Newer"}
POINTS["nc_dialects"] |= {"hostile": "others:Dialect"}


@pytest.fixture(autouse=True)
def hostile(tmp_path, monkeypatch):
    plugins.left_out.clear()
    modules = {"broken": BROKEN, "leaving": LEAVING}
    modules |= {"formats_here": FORMATS, "others": OTHERS}
    site = install(tmp_path / "site", POINTS, **modules)
    monkeypatch.syspath_prepend(site)


def test_lists_go_on_with_the_others(command):
    found = command.json("drivers")
    assert {"streaming", "geocom"} <= set(found["tracker"])
    assert {"broken", "leaving", "../up"}.isdisjoint(found["tracker"])
    found = [one["name"] for one in command.json("formats")["formats"]]
    assert {"linuxcnc", "csv"} <= set(found)
    assert {"broken", "leaving", "mute"}.isdisjoint(found)
    assert {"siemens-840d", "linuxcnc"} <= set(list_dialects())
    found = [one["name"] for one in command.json("effects")["effects"]]
    assert "backlash" in found
    assert "broken" not in found
    assert "backlash" in {family.name for family in list_families()}
    assert "effect.backlash" in catalogue("de")


def test_the_doctor_names_each_with_its_distribution_and_reason(capsys, tmp_path):
    run(["doctor", "--json", "--data-dir", str(tmp_path / "data")])
    findings = json.loads(capsys.readouterr().out)["findings"]
    told = [one for one in findings if one["subject"] == "plug-ins"]
    for group, points in POINTS.items():
        for name in {"broken", "leaving", "absent"} & set(points):
            said = [t for t in told if f"{group} plug-in {name!r}" in t["text"]]
            assert len(said) == 1, (group, name)
            assert NAME in said[0]["text"]
            assert said[0]["remedy"]
    assert any("the licence has run out" in one["text"] for one in told)


def list_plugins(capsys, *words):
    status = run(["plugins", "--json", *words])
    told = json.loads(capsys.readouterr().out)
    return status, told, {(p["group"], p["name"]): p for p in told["plugins"]}


def test_the_list_of_plug_ins_has_all_the_broken_ones_with_why(capsys):
    status, told, found = list_plugins(capsys)
    assert status == 1
    broken = found["effects", "broken"]
    assert f"{broken['distribution']} {broken['version']}" == NAME
    assert "the licence has run out" in broken["fault"]
    ours = found["motion_controllers", "grbl"]
    assert (ours["distribution"], ours["interface_version"]) == ("truepath", 1)
    assert not ours["fault"]
    assert any("'../up'" in why for why in told["left_out"])
    assert "version 7 of an interface" in found["effects", "newer"]["fault"]


@pytest.mark.long
def test_the_check_of_plug_ins_names_what_is_not_kept(capsys):
    status, _, found = list_plugins(capsys, "--check")
    assert status == 1
    assert found["effects", "backlash"]["was_checked"]
    assert not found["effects", "backlash"]["failures"]
    assert "no machine like this" in found["effects", "hostile"]["failures"][0]
    assert "no control like this" in found["nc_dialects", "hostile"]["failures"][0]
    assert not found["nc_dialects", "linuxcnc"]["failures"]
    assert not found["trackers", "geocom"]["was_checked"], "that needs a device"


def test_a_driver_that_is_not_checked_is_said_to_need_a_device(capsys, monkeypatch):
    groups = {DEVICES["thermometer"]: 1}
    monkeypatch.setattr(plugin_list, "INTERFACE_VERSIONS", groups)
    for words, ends in ((["--check"], "not checked: needs --device"), ([], "1")):
        run(["plugins", *words])
        (line,) = re.findall(r".*modbus-registers .*", capsys.readouterr().out)
        assert line.endswith(ends)


def test_a_list_of_plug_ins_that_is_broken_hides_nobody_elses(tmp_path, command):
    info = tmp_path / "site" / "hostile_plugins-1.2.dist-info" / "entry_points.txt"
    info.write_text("[truepath.trackers]\nno equals sign\n")
    assert "streaming" in command.json("drivers")["tracker"]


def test_a_dialect_that_breaks_is_named_where_it_is_asked_for(mill):
    path = default_path(mill, lines=4)
    with pytest.raises(BadInput, match=rf"{NAME}.*write\(\).*no control like this"):
        write_program(path, mill, "hostile")


@pytest.mark.long
def test_a_discovery_goes_on_without_an_effect_that_breaks(recorded, tmp_path):
    assert run(["discover", str(recorded), "-o", str(tmp_path / "found")]) == 0

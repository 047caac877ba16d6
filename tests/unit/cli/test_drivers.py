"""Drivers and their options: listed, and held against settings before use."""

import pytest

from truepath import device_options, errors
from truepath_drivers.tracker.text_line.driver import TextLineTracker


def test_every_installed_driver_is_listed_with_its_options(command):
    found = command.json("drivers")
    assert {"streaming", "text-line", "geocom", "t2sa"} <= set(found["tracker"])
    assert {"modbus", "linuxcnc"} <= set(found["motion"])
    assert "modbus-registers" in found["thermometer"]
    options = {one["name"]: one for one in found["tracker"]["text-line"]}
    assert options["rate_hz"] == {"name": "rate_hz", "type": "float", "required": True}
    assert options["unit"]["default"] == "mm"
    said = command.run("drivers").out
    assert 'tracker_driver = "streaming", tracker_options:' in said
    assert "has to be given" in said


@pytest.mark.parametrize(
    ("word", "name", "options", "said"),
    [
        ("tracker", "streaming", {"prot": "x"}, "'prot' is unknown; did you mean port"),
        ("tracker", "text-line", {"port": "x"}, "'rate_hz' is missing; give it (float"),
        ("tracker", "streaming", {"port": "x", "baudrate": "no"}, "baudrate is 'no'"),
        ("motion", "modbus", {"host": "h", "port": [502]}, "port is [502]"),
        ("motion", "no-such", {}, "no motion_controllers called 'no-such'"),
        ("thermometer", "modbus-registers", {"registers": 3}, "registers is 3"),
    ],
)
def test_what_a_driver_does_not_take_is_named_with_remedy(word, name, options, said):
    with pytest.raises(errors.BadInput) as caught:
        device_options.make_device(word, name, options)
    assert said in str(caught.value)


def test_numbers_that_come_as_text_are_numbers():
    options = {"port": "5000", "rate_hz": "250", "udp": "true", "host": "h"}
    tracker = device_options.make_device("tracker", "text-line", options)
    assert isinstance(tracker, TextLineTracker)
    assert tracker.capabilities.max_rate_hz == 250.0


def test_effects_are_listed_with_what_cannot_enter_an_analysis(command):
    found = {one["name"]: one for one in command.json("effects")["effects"]}
    assert found["backlash"]["enters_analyse"]
    assert "backlash compensation" in found["backlash"]["remedy"]
    assert not found["setup-step"]["enters_analyse"]
    said = command.run("effects").out
    assert "setup-step: Step of the set-up, of the measurement; ends with its" in said
    assert "  looks like  An axis stops short" in said

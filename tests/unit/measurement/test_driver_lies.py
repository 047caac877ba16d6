"""What a driver of somebody else breaks or lies about is found at its border."""

import pytest

from hostile_drivers import POINTS
from plugin_site import NAME, install
from truepath import driver_border, plugins
from truepath.device_options import make_device
from truepath_drivers.interfaces import errors, records

pytestmark = pytest.mark.fault_row(49)


@pytest.fixture(autouse=True)
def site(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(install(tmp_path / "site", POINTS))


@pytest.mark.parametrize(
    ("device", "verb", "fault"),
    [
        ("tracker", "connect", "none"),
        ("tracker", "read", "none"),
        ("tracker", "read", "flat"),
        ("tracker", "take_link_bytes", "tuple"),
        ("tracker", "start", "exit"),
        ("motion", "connect", "exit"),
        ("motion", "connect", "raise"),
        ("motion", "connect", "unpicklable"),
        ("motion", "status", "none"),
        ("motion", "status", "raise"),
        ("motion", "status", "two-axes"),
        ("motion", "status", "texts"),
        ("motion", "status", "tuple"),
        ("thermometer", "read", "tuple"),
    ],
)
def test_what_breaks_or_lies_is_an_error_of_driver_call_and_remedy(device, verb, fault):
    made = make_device(device, "hostile", {"verb": verb, "fault": fault})
    given = {"read": (0.1,), "start": (500.0,)} if device == "tracker" else {}
    with pytest.raises(errors.DeviceError, match=rf"{NAME}.* {verb}\(\).*; update"):
        getattr(made, verb)(*given.get(verb, ()))


def test_what_is_of_the_drivers_own_class_arrives_as_what_everybody_knows():
    status = make_device("motion", "hostile", {"verb": "status", "fault": "own-class"})
    assert type(status.status()) is records.MotionStatus
    lost = make_device("motion", "hostile", {"verb": "connect", "fault": "own-error"})
    with pytest.raises(errors.ConnectionLost, match="the cable is out") as caught:
        lost.connect()
    assert caught.type is errors.ConnectionLost


def test_a_guarded_device_tells_which_plug_in_it_is_of():
    made = make_device("motion", "hostile", {"verb": "status", "fault": "own-class"})
    found = driver_border.list_origins(motion=made, thermometers=None, tracker=object())
    name, version = NAME.split()
    assert found == {"motion": plugins.PluginOrigin("hostile", name, version, 1)}

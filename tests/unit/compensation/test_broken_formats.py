"""Formats of somebody else that break, lie, or name places of their own."""

import pytest

from plugin_site import NAME, install
from truepath.compensation.export import export_result, write_output
from truepath.compensation.tables.error_map import map_errors
from truepath.errors import BadInput

pytestmark = pytest.mark.fault_row(49)

FORMATS = """
    import math
    from truepath.compensation.formats.generic import GenericCsv
    from truepath.compensation.formats.linuxcnc import LinuxCnc

    class Climbing(LinuxCnc):
        def write(self, content):
            return {"../" + name: text for name, text in super().write(content).items()}

    class Hollow(GenericCsv):
        def write(self, content):
            files = super().write(content)
            return {name: text.replace("0.0", "nan", 1) for name, text in files.items()}

    class Raising(GenericCsv):
        def write(self, content):
            raise ZeroDivisionError("no axis")

    class Nothing(GenericCsv):
        def write(self, content):
            return None

    class Blind(GenericCsv):
        def read(self, files, machine):
            return lambda position, direction: math.nan * position[:, :3]

    class Unread(GenericCsv):
        def read(self, files, machine):
            raise KeyError("X")
"""


def export_into(folder, loaded, name):
    made = export_result(map_errors(loaded), name, "c", spacing_mm=50.0)
    place, source = folder / "deep" / "out" / "c", folder / "result.json"
    write_output(made.files, made.account, place, "c", source=source)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("climbing", "no plain file name"),
        ("hollow", "nan"),
        ("raising", "no axis"),
        ("nothing", r"write\(\)"),
        ("blind", "finite"),
        ("unread", r"read\(\)"),
    ],
)
def test_a_format_that_breaks_writes_nothing_and_is_named(
    loaded, tmp_path, monkeypatch, name, said
):
    points = {"compensation_formats": {name: f"formats_here:{name.capitalize()}"}}
    site = install(tmp_path / "site", points, formats_here=FORMATS)
    monkeypatch.syspath_prepend(site)
    with pytest.raises(BadInput, match=rf"{name}. of {NAME}.*{said}"):
        export_into(tmp_path, loaded, name)
    assert not [*tmp_path.rglob("*.csv"), *tmp_path.rglob("*.tbl")]

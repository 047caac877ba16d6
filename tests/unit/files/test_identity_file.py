"""Identities: read from files and words."""

import json

import pytest

from truepath.errors import BadInput, BundleError
from truepath.files.bundle import identity_file


@pytest.mark.parametrize(
    ("content", "place"),
    [
        ({"schema": "identity/2"}, "schema"),
        ({"opertor": "A"}, '"opertor" is no field'),
        ({"operator": 3}, "operator is 3"),
        ({"operator": "A\nB"}, "one line"),
        ([], "is no object"),
    ],
)
def test_a_wrong_identity_is_refused_by_its_key(tmp_path, content, place):
    file = tmp_path / "identity.json"
    file.write_text(json.dumps(content))
    with pytest.raises(BundleError, match=place):
        identity_file.read_identity(file)


def test_earlier_names_are_read_on_and_what_is_of_no_use_is_named(tmp_path):
    stated = identity_file.read_assignments(["machine_serial=1", "tracker_serial=2"])
    assert stated == {"serial_number": "1", "tracker_serial_number": "2"}
    (tmp_path / "identities.json").write_text("{}")
    with pytest.raises(BundleError, match="holds no machines"):
        identity_file.read_stored_identities(tmp_path / "identities.json")
    assert identity_file.read_stored_identities(tmp_path / "none.json") == {}
    with pytest.raises(BadInput, match="FIELD=TEXT"):
        identity_file.read_assignments(["operator"])

"""Identities: read from files and words, kept for each machine."""

import json

import pytest

from truepath.app.errors import BadInput, BundleError
from truepath.app.files.identity_file import (
    IdentityStore,
    read_assignments,
    read_identity,
)


def test_what_was_stated_once_is_there_the_next_time(tmp_path):
    IdentityStore.of_folder(tmp_path).keep("mill", {"operator": "A. Weiß"})
    store = IdentityStore.of_folder(tmp_path)
    assert store.keep("mill", {"place": "Hall 3"}) == {
        "operator": "A. Weiß",
        "place": "Hall 3",
    }
    assert store.load("mill")["operator"] == "A. Weiß"
    assert store.load("lathe") == {}


def test_what_holds_for_one_measurement_is_not_kept(tmp_path):
    store = IdentityStore.of_folder(tmp_path)
    assert store.keep("mill", {"measured_on": "2026-11-24"})
    assert store.load("mill") == {}


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
        read_identity(file)


def test_a_word_that_states_nothing_is_refused():
    with pytest.raises(BadInput, match="FIELD=TEXT"):
        read_assignments(["operator"])


def test_a_damaged_store_is_not_written_over(tmp_path):
    (tmp_path / "identities.json").write_text("{}")
    with pytest.raises(BundleError, match="holds no machines"):
        IdentityStore.of_folder(tmp_path).keep("mill", {"operator": "A"})
    assert (tmp_path / "identities.json").read_text() == "{}"

"""What is installed is looked for once, however many plug-ins there are."""

from functools import partial

import pytest

from truepath import plugins
from truepath.compensation.format_registry import list_formats
from truepath.kinematics.effects.family import list_families
from truepath.service.page.pages import LANGUAGES, catalogue


@pytest.fixture
def searches(monkeypatch):
    """The entry-point groups that were searched, in order.

    Each search reads the metadata of every installed distribution, some 10 ms.
    """
    groups, find = [], plugins.entry_points

    def search(group):
        groups.append(group)
        return find(group=group)

    monkeypatch.setattr(plugins, "entry_points", search)
    return groups


@pytest.mark.parametrize(
    ("find", "group"),
    [
        (list_families, "effects"),
        (list_formats, "compensation_formats"),
        *((partial(catalogue, language), "effects") for language in LANGUAGES),
    ],
)
def test_a_group_or_the_texts_of_a_page_are_found_in_one_search(searches, find, group):
    assert len(find()) >= 10
    assert searches == [f"truepath.{group}"]

"""What is installed is looked for once, however many plug-ins there are."""

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


def test_all_effects_are_found_in_one_search(searches):
    assert len(list_families()) > 10
    assert searches == ["truepath.effects"]


def test_all_compensation_formats_are_found_in_one_search(searches):
    assert len(list_formats()) >= 10
    assert searches == ["truepath.compensation_formats"]


@pytest.mark.parametrize("language", LANGUAGES)
def test_the_texts_of_a_page_cost_one_search(language, searches):
    assert catalogue(language)
    assert searches == ["truepath.effects"]

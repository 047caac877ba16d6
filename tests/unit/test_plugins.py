"""What is installed is looked for once, however many plug-ins there are."""

from functools import partial
from unittest.mock import Mock, patch

import pytest

from truepath import plugins
from truepath.compensation.format_registry import list_formats
from truepath.kinematics.effects.family import list_families
from truepath.service.page.pages import LANGUAGES, catalogue


@pytest.mark.parametrize(
    ("find", "group"),
    [
        (list_families, "effects"),
        (list_formats, "compensation_formats"),
        *((partial(catalogue, language), "effects") for language in LANGUAGES),
    ],
)
def test_a_group_or_the_texts_of_a_page_are_found_in_one_search(find, group):
    """Each search reads the metadata of every installed distribution, some 10 ms."""
    spied = Mock(wraps=plugins.entry_points)
    with patch.object(plugins, "entry_points", spied):
        assert len(find()) >= 10
    spied.assert_called_once_with(group=f"truepath.{group}")

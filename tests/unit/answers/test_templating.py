"""Templates that are compiled once, and pages where that cannot be kept."""

import pytest
from jinja2 import DictLoader

from truepath.answers.shown import templating


@pytest.fixture
def environment(tmp_path):
    cache = templating.CompiledTemplates(str(tmp_path))
    loader = DictLoader({"page.html": "<p>{{ text }}</p>"})
    return templating.ENVIRONMENT.overlay(loader=loader, bytecode_cache=cache)


def test_a_template_is_compiled_once(environment, tmp_path, monkeypatch):
    environment.get_template("page.html")
    assert len(list(tmp_path.iterdir())) == 1
    again = environment.overlay(cache_size=1)
    monkeypatch.setattr(type(again), "compile", None)  # would fail
    assert again.get_template("page.html").render(text="<") == "<p>&lt;</p>"


def test_a_page_is_made_where_nothing_can_be_kept(environment, tmp_path):
    tmp_path.rmdir()
    assert environment.get_template("page.html").render(text="a") == "<p>a</p>"


@pytest.mark.parametrize("error", [RuntimeError, PermissionError])
def test_a_user_without_a_folder_has_no_kept_templates(monkeypatch, error):
    def refuse(self):
        raise error

    monkeypatch.setattr(templating.CompiledTemplates, "_get_default_cache_dir", refuse)
    assert templating.find_compiled() is None

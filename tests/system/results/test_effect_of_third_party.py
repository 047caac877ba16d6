"""The effect of docs/write-an-effect.md goes the whole way, its own keys with it."""

import importlib.util
import json
import re
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from truepath import plugins
from truepath.answers import discovery, discovery_report
from truepath.answers.calibration_report import render_analysis
from truepath.answers.plan_report import plan_document, render_plan_report
from truepath.estimation.problem.prior_model import PriorModel
from truepath.files.earlier.result_file import result_from_json
from truepath.kinematics.effects.conformance import CHECKS, example_conditions
from truepath.planning.plan import make_plan
from truepath.planning.plan_request import PlanRequirements
from truepath.results.analysis import analyse
from truepath.service.page.pages import catalogue
from truepath_simulators.hidden.structure import ElasticSag
from truepath_simulators.worlds.synthetic import Setting

PAGE = Path(__file__).parents[3] / "docs" / "write-an-effect.md"
KEYS = {"beam": "X", "load": "Y", "toward": "Z"}
NAME, TITLE = "bending-beam", "Bending beam of X under Y toward Z"


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    source, scanned, *_ = re.findall(
        r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.S
    )
    file = tmp_path_factory.mktemp("third-party") / "bending_beam.py"
    words = "\n\nRackWaveFamily.words = BendingBeamFamily.words\n"
    file.write_text(source + "\n\n" + scanned + words, encoding="utf-8")
    spec = importlib.util.spec_from_file_location("bending_beam", file)
    module = importlib.util.module_from_spec(spec)
    sys.modules["bending_beam"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["bending_beam"]


@pytest.fixture(scope="module")
def installed(example):
    point = EntryPoint(NAME, "bending_beam:BendingBeamFamily", "truepath.effects")
    found = plugins.entry_points

    def list_points(group):
        return [point] if group == "truepath.effects" else found(group=group)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plugins, "entry_points", list_points)
        yield example


@pytest.fixture(scope="module")
def run(record):
    setting = Setting(hidden=(ElasticSag("X", "Y", "Z", 14.0),))
    return record(7, rows=40, travel_mm=200.0, setting=setting)[0]


@pytest.fixture(scope="module")
def discovered(installed, run):
    return discovery.discover_runs([run])


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_the_example_of_the_page_conforms(check, example):
    check(example.BendingBeamFamily(), example_conditions())


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_the_scanned_wave_of_the_page_conforms(check, example):
    check(example.RackWaveFamily(), example_conditions())


def test_the_scan_of_the_page_rises_by_a_quarter_wave_over_the_travel(example):
    family, at = example.RackWaveFamily(), example_conditions()
    candidate = family.propose(at)[0]
    scan = family.scan(candidate, at)
    assert scan.name == "period_mm"
    assert (np.diff(scan.values) > 0.0).all()
    assert np.allclose(np.diff(500.0 / scan.values), -0.25)
    effect = family.with_value(candidate, 20.0).effect
    assert effect == example.RackWave(at.machine.linear_axes[0], 20.0)


def test_it_is_discovered_by_its_own_keys_and_words(discovered, installed):
    (effect,) = discovered.content["effects"]
    assert effect["name"] == NAME
    assert {key: effect[key] for key in KEYS} == KEYS
    assert effect["cause"].startswith("A beam bends")
    found = discovered.found, discovered.model, discovered.proposal
    assert TITLE in discovery_report.render_discovery_report(*found, discovery.ASK)
    german = catalogue("de")
    assert german[f"effect.{NAME}"] == "Biegung eines Balkens"
    assert german[f"effect.{NAME}.cause"].startswith("Ein Balken")


def test_analysis_and_plan_by_the_model_file_tell_it_apart_and_name_it(run, discovered):
    content = json.loads(json.dumps(discovered.model.content))
    result = result_from_json(content, file="model.json")
    model = PriorModel(result, "model.json", "ab")
    (known,) = model.result.model.catalogue_effects
    assert (dict(known.keys), known.title) == (KEYS, TITLE)
    found = render_analysis(analyse(run, model=model))
    (effect,) = found.result["effects"]
    assert {key: effect[key] for key in KEYS} == KEYS
    assert TITLE in found.report_html
    plan = make_plan(run.machine, PlanRequirements(minutes=1.0, model=model))
    document = plan_document(plan)
    (effect,) = document["predicted"]["effects"]
    assert {key: effect[key] for key in KEYS} == KEYS
    assert TITLE in render_plan_report(document)

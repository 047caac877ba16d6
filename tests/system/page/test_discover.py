"""The step after the result: what the model lacks, and how far the gap has closed."""

import copy
import re

import pytest
from playwright.sync_api import Page, expect

from page_steps import NEXT, PHONE, assert_fits, choose, follow, go, job_of, prepare
from scripted_data import ASK, DISCOVERY
from truepath.files.earlier.verdict import Reason, Verdict, verdict_json
from truepath.kinematics.effects.family import list_families
from truepath.service.page.pages import catalogue

WORDS = ("cause", "looks_like", "remedy")


def test_a_discovery_is_asked_for_after_a_result_and_shows_findings(panel, service):
    page = panel.open(f"#/result/{service.measured()}")
    page.get_by_role("link", name="Discover").click()
    expect(page.locator("main")).to_contain_text("Nothing moves")
    follow(page, "Look for missing effects")
    page.wait_for_url("**/#/run/*")
    (order,) = service.orders()
    assert order["kind"] == "discover"
    assert order["run_id"]
    expect(page.locator(".stages [aria-current]")).to_have_text("Discovering")
    job = job_of(page)
    service.finish(job)
    page.wait_for_url(f"**/#/discover/{job}")
    finding = page.locator("[data-effect=backlash]")
    expect(finding.locator("h2")).to_have_text("Backlash Y")
    expect(finding).to_contain_text("width 6.34 ± 0.13 µm")
    expect(finding).to_contain_text("Play or wind-up in screw")
    expect(finding).to_contain_text("Enter the width as the axis' backlash comp")
    expect(finding).to_contain_text("closes 94 % of the gap above the noise")
    expect(finding).to_contain_text("Servo mismatch Y")
    # How sure it is stands before its evidence.
    graded = finding.locator(".graded")
    expect(graded.locator("p")).to_be_hidden()
    graded.locator("summary", has_text="certain").click()
    expect(graded.locator("p")).to_contain_text("log Bayes factor 4,504")
    step = page.locator("[data-effect=setup-step]")
    expect(step).to_contain_text("moment 40.020 ± 0.060 s")
    expect(step).to_contain_text("step X 4.00 ± 0.20, Y −3.00 ± 0.20, Z 0.10 ± 0.20 µm")
    expect(step).to_contain_text("nothing else explains it as well")
    # Structure without a name is told by what it depends on.
    card = page.locator("[data-structure]")
    expect(card.locator("h2")).to_have_text("Wave in time, along Z")
    expect(card).to_contain_text("period 31.04 ± 0.12 s; amplitude 1.13 ± 0.10 µm")
    expect(card).to_contain_text("none is forced on it")
    expect(card.locator("dd").first).to_have_text("Time")
    expect(card).to_contain_text("Something switches with a steady period.")


def test_the_gap_and_where_it_lies_are_drawn_with_their_numbers(panel, service):
    service.discovery = copy.deepcopy(DISCOVERY)
    shares = {"temperature of X": 0.06, "region of X and Y": 0.055}
    service.discovery["explained_by"]["before"] |= shares
    job = discovered(service)
    page = panel.open(f"#/discover/{job}")
    gap = DISCOVERY["gap"]
    expect(page.locator(".gap dd").first).to_contain_text("1.45 µm")
    before, after, floor = (
        page.locator(name).bounding_box()
        for name in (".gap .is-before", ".gap .is-after", ".gap-floor")
    )
    reach = floor["x"] + 1.0 - before["x"]
    for width, name in ((after["width"], "after"), (reach, "noise_floor")):
        share = gap[name] / gap["before"]
        assert width / before["width"] == pytest.approx(share, abs=0.01)
    expect(page.locator(".gap-key")).to_have_text("Noise floor 1.18 µm")
    card = page.locator(".card", has=page.locator(".gap"))
    expect(card).to_contain_text("complete model on these lines: 1.19 µm")
    for name, address in (
        ("Report", f"/api/v1/jobs/{job}/discovery/report.html$"),
        ("Model", f"/api/v1/models/{job}$"),
    ):
        link = page.get_by_role("link", name=name)
        expect(link).to_have_attribute("href", re.compile(address))
    page = panel.open(f"#/discover/{job}", language="de")
    strips = page.locator(".heat-strip")
    expect(strips.locator("b")).to_contain_text(
        ["Geraden", "Bewegte Achse", "Zeit", "Temperatur X"]
    )
    expect(strips.nth(2).locator(".strip-ends")).to_contain_text("0:00")
    lines = strips.first.locator(".strip-row").first.locator("i")
    expect(lines).to_have_count(22)
    heat = lines.evaluate_all(
        "all => all.map((i) => parseInt(i.style.getPropertyValue('--heat')))"
    )
    assert heat[18] == max(heat) == 100  # row 19 is off by 6.45 µm
    assert heat[0] == round(100 * 5.55 / 6.45)
    ends = strips.nth(3).locator(".strip-ends span")  # 0.05 °C a line
    expect(ends).to_have_text(["20,05 °C", "21,10 °C"])
    expect(page.locator("[data-strips]")).to_contain_text("je kräftiger die Farbe")
    page.locator(".strips-table summary").click()
    axes = page.locator(".strips-table table").nth(1)
    expect(axes.locator("tbody tr", has_text="Y−")).to_contain_text("1,20 µm")
    names = ["Gerade", "Richtung von Y", "Bewegte Achse", "Temperatur X"]
    names += ["Bereich von X und Y", "Zeit"]
    expect(page.locator(".shares dt")).to_have_text(names)
    expect(page.locator(".shares dd").nth(1)).to_have_text("33 %, nachher 0 %")
    bars = page.locator(".shares .is-before")
    first, second = (bars.nth(row).bounding_box()["width"] for row in (0, 1))
    assert second / first == pytest.approx(0.330 / 0.581, abs=0.01)
    versions = page.locator("[data-versions] .versions > li")
    expect(versions).to_have_count(2)
    expect(versions.first.locator("ul li")).to_have_text(
        [
            "neu Umkehrspiel Y: Breite 6,34 ± 0,13 µm",
            "geändert EXX bei X 305 mm: von 22,5 auf 24,19 ± 0,73 µm",
            "geändert C0Y: von 12,0 auf 18,5 ± 1,1 µrad",
        ]
    )
    expect(versions.last).to_contain_text("Kein Unterschied")
    page.set_viewport_size({"width": PHONE[0], "height": PHONE[1]})
    choose(page, "Dunkel")
    expect(page.locator("h1")).to_have_text("Was dem Modell fehlt")
    expect(page.locator("[data-effect=backlash] h2")).to_have_text("Umkehrspiel Y")
    assert_fits(page)


def turn_to(page: Page, service, **change) -> str:
    service.discovery = copy.deepcopy(DISCOVERY) | change
    job = discovered(service)
    go(page, f"#/discover/{job}")
    return job


def test_findings_are_told_by_what_is_known_and_first_if_to_be_used(panel, service):
    values = {"ratio": 6.0, "limit_ratio": 1.6}
    reason = Reason("fit-beyond-noise", "not-usable", values)
    service.discovery = DISCOVERY | {"verdict": verdict_json(Verdict((reason,)))}
    job = service.done("discover", run_id="run-9", verdict="not-usable")
    page = panel.open(f"#/discover/{job}")
    band = page.locator(".verdict-band")
    expect(band.get_by_role("heading")).to_have_text("Not to be used")
    expect(band.locator("li")).to_contain_text("6.00 times that of noise")
    link = page.locator("a[download]")
    expect(link).to_have_attribute("download", "not-to-be-used-model.json")
    turn_to(page, service, effects=[], unnamed=[])
    expect(page.locator(".notice")).to_contain_text("Nothing is missing")
    expect(page.locator("[data-effect]")).to_have_count(0)
    (wave,) = DISCOVERY["unnamed"]
    known = {name: wave[name] for name in ("depends_on", "description", "rms_um")}
    turn_to(page, service, unnamed=[known])
    card = page.locator("[data-structure]")
    expect(card).to_contain_text("A wave in time along Z with a period of 31 s")
    backlash = DISCOVERY["effects"][0]
    lateral = {"name": "lateral-backlash", "motion": "ECY", "unit": "urad"}
    parameters = {"half_width": {"value": 5.0, "uncertainty": 0.2}}
    tilt = backlash | lateral | {"parameters": parameters}
    turn_to(page, service, effects=[tilt, backlash])
    card = page.locator("[data-effect=lateral-backlash]")
    expect(card.locator("h2")).to_have_text("Lateral backlash ECY")
    expect(card).to_contain_text("half width 5.00 ± 0.40 µrad")
    choose(page, "inch")
    inches = page.locator("[data-effect=backlash] .finding-numbers")
    expect(inches).to_contain_text("width 249.7 ± 5.2 µin")
    expect(card).to_contain_text("half width 5.00 ± 0.40 µrad")


def test_a_model_is_used_by_the_next_plan_until_that_is_ended(panel, service):
    job = discovered(service)
    page = panel.open(f"#/discover/{job}")
    expect(page.get_by_role("link", name="Export with it")).to_have_attribute(
        "href", f"#/export/{job}"
    )
    page.get_by_role("button", name="Use this model").click()
    expect(page.locator("[data-closing]")).to_contain_text("In use")
    page.evaluate("location.hash = '#/plan'")
    expect(page.locator("[data-model]")).to_contain_text("in use")
    prepare(page)
    assert [order["model_id"] for order in service.orders()] == [job]
    page.evaluate("location.hash = '#/plan'")
    page.locator("[data-model]").get_by_role("button").click()
    expect(page.locator("[data-model]")).to_have_count(0)


def test_extra_lines_are_asked_for_with_the_reason_and_driven_once_held(panel, service):
    service.discovery = copy.deepcopy(DISCOVERY) | {"ask": ASK}
    job = discovered(service)
    page = panel.open(f"#/discover/{job}")
    card = page.locator("[data-ask]")
    expect(card.locator("li").first).to_have_text(
        "Backlash Y or Servo mismatch Y? Both explain the measurement alike."
    )
    expect(card.locator("li").last).to_have_text(
        "Step of the set-up? The evidence for it is thin."
    )
    expect(card).to_contain_text("0:16 min")
    expect(card).to_contain_text("2,400 mm/min, 6,000 mm/min")
    expect(card).to_contain_text("log Bayes factor 15; 12 decides")
    expect(card).to_contain_text("expected to decide.")
    expect(page.locator(NEXT)).to_have_text("Measure the extra lines")
    extra = prepare(page)
    assert service.orders() == [{"kind": "measure-extra", "discovery_id": job}]
    service.change(extra, state="ready")
    expect(page.locator(".pairs", has_text="Extra lines")).to_be_visible()
    expect(page.locator(".planned-grade")).to_be_hidden()
    assert service.jobs[extra]["state"] == "ready"
    button = page.locator(NEXT, has_text="Hold to start motion")
    expect(button).to_be_enabled()
    button.focus()
    page.keyboard.down("Enter")
    page.wait_for_url(f"**/#/run/{extra}")
    page.keyboard.up("Enter")
    stages = ["Planning", "Measuring", "Discovering", "Reporting"]
    expect(page.locator(".stages li")).to_have_text(stages)
    expect(page.locator(".run-chooser")).to_have_count(0)
    service.discovery = DISCOVERY | {"effects": DISCOVERY["effects"][:1], "ask": None}
    service.finish(extra)
    page.wait_for_url(f"**/#/discover/{extra}")
    expect(page.locator("[data-effect=backlash] h2")).to_have_text("Backlash Y")
    expect(page.locator("[data-ask]")).to_have_count(0)
    expect(page.locator(NEXT)).to_have_text("Correct the machine")


def test_extra_lines_wait_for_the_devices_and_for_each_other(panel, service):
    service.discovery = copy.deepcopy(DISCOVERY) | {"ask": ASK | {"decides": False}}
    job = discovered(service)
    service.connected = False
    page = panel.open(f"#/discover/{job}")
    expect(page.locator("[data-ask]")).to_contain_text("not expected to decide")
    expect(page.locator(NEXT)).to_be_disabled()
    expect(page.locator("#reason")).to_have_text("Connect the devices first.")
    page.goto(f"{panel.address}/nothing")
    service.connected = True
    other = service.measuring()
    page.goto(f"{panel.address}/#/discover/{job}")
    expect(page.locator("#reason")).to_contain_text("Another job is running")
    service.finish(other)
    expect(page.locator(NEXT)).to_be_enabled()


def test_late_events_of_discarded_extra_lines_do_not_hide_the_discovery(panel, service):
    service.discovery = copy.deepcopy(DISCOVERY) | {"ask": ASK}
    job = discovered(service)
    service.plan["discovery_id"] = job
    extra = service.new_job("measure-extra", state="ready")["id"]
    page = panel.open(f"#/check/{extra}")
    expect(page.locator(".path-view[data-drawn]")).to_be_visible()
    drive = page.locator(NEXT, has_text="Measure the extra lines")
    with service.telling_late():
        page.get_by_role("button", name="Discard").click()
        page.wait_for_url(f"**/#/discover/{job}")
        expect(page.locator("[data-ask]")).to_be_visible()
        expect(drive).to_be_disabled()
    expect(drive).to_be_enabled()
    expect(page.locator("[data-ask]")).to_be_visible()
    assert page.url.endswith(f"#/discover/{job}")
    assert service.jobs[extra]["state"] == "aborted"
    go(page, f"#/run/{extra}")
    follow(page, "Back to the discovery")
    page.wait_for_url(f"**/#/discover/{job}")


def test_every_effect_of_the_catalogue_is_told_in_german(panel, service):
    german, kinds = catalogue("de"), list_families()
    service.discovery = copy.deepcopy(DISCOVERY) | {
        "effects": [told(k) for k in kinds if k.names_cause],
        "unnamed": [told(k) for k in kinds if not k.names_cause],
    }
    page = panel.open(f"#/discover/{discovered(service)}", language="de")
    expect(page.locator("[data-effect], [data-structure]")).to_have_count(len(kinds))
    shown = page.locator("main").inner_text()
    for kind in kinds:
        for word in WORDS:
            assert german[f"effect.{kind.name}.{word}"] in shown
            assert getattr(kind.words["en"], word) not in shown
        assert german[f"effect.{kind.name}"] in shown
        assert kind.name not in shown
    # An effect of others keeps the words it came with.
    own = DISCOVERY["effects"][1] | {"name": "loose-belt", "cause": "The belt is old."}
    turn_to(page, service, effects=[own])
    card = page.locator("[data-effect=loose-belt]")
    expect(card.locator("h2")).to_have_text("loose-belt")
    expect(card).to_contain_text("The belt is old.")


def told(kind) -> dict:
    words = {word: getattr(kind.words["en"], word) for word in WORDS}
    names = {"structure": kind.name, "depends_on": ["t"], "description": "a thing"}
    names = names if not kind.names_cause else {"name": kind.name}
    return copy.deepcopy(DISCOVERY["effects"][1]) | names | words


def discovered(service) -> str:
    return service.done("discover", run_id="run-9")


def test_what_is_looked_for_is_listed_when_it_is_asked_for(panel, service):
    page = panel.open(f"#/discover/{service.measured()}")
    page.get_by_text("What is looked for").click()
    listed = page.locator("main details dt")
    expect(listed).to_have_text(["Backlash", "Step of the set-up"])
    expect(page.locator("main details")).to_contain_text("It ends with its measurement")

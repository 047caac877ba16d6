"""From the first look to the certificate, by the one button that leads on."""

import copy
import json
import re
from typing import Any

from playwright.sync_api import Locator, Page, Route, expect

import scripted_data
from page_steps import (
    NEXT,
    PHONE,
    Taps,
    assert_fits,
    choose,
    expect_texts,
    follow,
    go,
    held,
    job_of,
    prepare,
)
from scripted_data import (
    EXAMPLES,
    MACHINE,
    machine_entry,
    machine_history,
    verification,
)
from scripted_service import ScriptedService
from truepath.files.earlier.verdict import Reason, Verdict, verdict_json

TABLES_AT_MOST, CERTIFICATE_AT_MOST = 4, 9


def measure(taps: Taps, service) -> str:
    page = taps.page
    taps.press("Connect devices")
    expect(page.locator("#answered")).to_contain_text("Simulated tracker SIM-000001")
    taps.press("Prepare the run")
    expect(page.locator("#reason")).to_contain_text("preparing the path")
    expect(page.locator(NEXT)).to_be_disabled()
    (job,) = service.jobs
    service.change(job, state="ready")
    expect(page.locator(".path-view[data-drawn]")).to_be_visible()
    taps.hold_until("Hold to start motion", f"**/#/run/{job}")
    return job


def test_the_task_runs_from_connect_to_a_certificate_in_nine_taps(panel, service):
    taps = Taps(panel.open(size=PHONE, touch=True))
    job, page = measure(taps, service), taps.page
    service.advance(job, 11.0)
    expect(page.locator(".big-progress strong")).to_have_text("50%")
    expect(page.locator(".stages [aria-current]")).to_have_text("Measuring")
    expect(page.locator(".tile", has_text="Lost samples")).to_contain_text("0")
    expect(page.locator(NEXT)).to_be_disabled()
    service.change(job, stage="estimating")
    expect(page.locator("#state")).to_have_text("Analysing")
    service.finish(job)
    page.wait_for_url(f"**/#/result/{job}")
    expect(page.locator(".chart canvas")).to_have_count(17)
    expect(page.locator(".chart-missing")).to_have_count(1)
    expect(page.locator("td.symbol")).to_have_text(["C0Y", "B0Z", "A0Z"])
    expect(page.locator(".key", has_text="k = 2")).to_be_visible()
    assert taps.count <= TABLES_AT_MOST
    taps.press("Correct the machine")
    taps.press("Verify the machine")
    taps.press("Certificate without it", where="#aside button")
    taps.press("Issue the certificate")
    frame = page.frame_locator("iframe.preview")
    expect(frame.locator("h1")).to_contain_text("TP-20260314-JOB-1-1")
    assert taps.count <= CERTIFICATE_AT_MOST
    expect(page.locator(NEXT)).to_have_text("New measurement")
    assert [path for _, path, _ in service.requests if "certif" in path] == [
        f"/jobs/{job}/certificates"
    ]


def test_a_verification_has_a_verdict_and_nine_taps_to_its_certificate(panel, service):
    taps = Taps(panel.open(size=PHONE, touch=True))
    result, page = measure(taps, service), taps.page
    service.finish(result)
    taps.press("Correct the machine")
    taps.press("Verify the machine")
    page.get_by_role("checkbox", name="Diagonals").click()
    page.get_by_label("Largest deviation allowed").fill("5")
    taps.press("Prepare the points")
    page.wait_for_url("**/#/check/*")
    proof = job_of(page)
    points = {"what": ["random-points"], "tolerance_um": 5}
    assert service.orders()[-1] == {"kind": "verify", "result_id": result, **points}
    service.verifications[proof] = verification(result)
    service.change(proof, state="ready")
    taps.hold_until("Hold to start motion", f"**/#/run/{proof}")
    service.finish(proof)
    page.wait_for_url(f"**/#/verify/{proof}")
    taps.press("To the certificate")
    expect(page.get_by_role("checkbox", name="With the verification")).to_be_checked()
    taps.press("Issue the certificate")
    expect(page.locator("iframe.preview")).to_be_visible()
    assert taps.count <= CERTIFICATE_AT_MOST
    assert service.requests[-1][2]["verification_job"] == proof
    assert [kind for _, kind, _ in service.requests if kind.endswith("/arm")] == [
        f"/jobs/{each}/arm" for each in (result, proof)
    ]
    verdict = page.locator(".proof")
    for conformity, word in (
        ("within", "Pass"),
        ("outside", "Fail"),
        ("undecided", "Undecided"),
    ):
        if conformity != "within":
            proof = service.verified(verification(result, conformity))
        go(page, f"#/verify/{proof}")
        expect(verdict.locator("h2")).to_have_text(word)
        expect(verdict).to_contain_text("2.10 µm ± 0.40 µm against 5.00 µm")
        expect(page.locator(".proof-table tbody tr")).to_have_count(3)


def test_a_missing_watchdog_is_read_before_planning(panel, service, monkeypatch):
    monkeypatch.setitem(scripted_data.DEVICES["motion"], "has_watchdog", False)
    page = panel.open("#/connect")
    follow(page, "Connect devices")
    expect(page.locator(NEXT)).to_have_text("Plan the run")
    expect(page.locator("main")).to_contain_text("No watchdog: the machine moves on")
    expect(page.locator("[data-connected]")).to_have_count(3)
    expect(page.locator(".pairs > *", has_text="500 Hz")).to_be_visible()


def test_another_certificate_waits_for_the_verification_that_came_since(panel, service):
    result = service.measured()
    proof = service.verified(verification("another result"))
    page = panel.open(f"#/certificate/{result}")
    follow(page, "Issue the certificate")
    another = page.locator("#aside button", has_text="Issue another")
    expect(another).to_be_enabled()
    page.locator(".step a", has_text="Export").click()
    service.verifications[proof] = verification(result)
    held: list[Route] = []
    page.route("**/verification", lambda route: held.append(route))
    with page.expect_request("**/verification"):
        page.locator(".step a", has_text="Certificate").click()
    expect(another).to_be_disabled()
    for route in held:
        route.continue_()
    page.unroute("**/verification")
    another.click()
    expect(page.locator(".kept-list li")).to_have_count(2)
    assert service.requests[-1][2]["verification_job"] == proof


def test_a_certificate_is_looked_at_before_it_is_issued(panel, service):
    page = panel.open(f"#/certificate/{service.measured()}")
    page.locator("#state-operator").fill("A. Weiß")
    page.get_by_role("button", name="Preview").click()
    shown = page.frame_locator("iframe.preview").locator("body")
    expect(shown).to_contain_text("PREVIEW")
    expect(shown).to_contain_text("A. Weiß")
    expect(page.locator(".preview-card a")).to_have_count(0)  # there is no file
    expect(page.locator(".kept-list")).to_have_count(0)
    expect(page.locator(NEXT)).to_have_text("Issue the certificate")


def test_files_with_what_a_discovery_found_are_verified_and_certified(panel, service):
    result = service.measured()
    found = service.done("discover", run_id=service.jobs[result]["run_id"])
    made = scripted_data.compensation(found, "linuxcnc", "hold")
    service.compensations[found] = [made]
    page = panel.open(f"#/export/{found}")
    follow(page, "Verify the machine")
    page.wait_for_url(f"**/#/verify/{found}")
    page.locator("#verify-files").select_option(made["id"])
    proof = prepare(page)
    order = service.requests[-1][2]
    assert (order["result_id"], order["compensation_id"]) == (found, made["id"])
    asked = {"result_id": found, "compensation_id": made["id"]}
    service.verifications[proof] = verification(found) | {"asked": asked}
    service.change(proof, state="running", stage="measuring")
    service.finish(proof)
    page.wait_for_url(f"**/#/verify/{proof}")
    follow(page, "To the certificate")
    page.wait_for_url(f"**/#/certificate/{result}")
    expect(page.get_by_role("checkbox", name="With the verification")).to_be_checked()
    follow(page, "Issue the certificate")
    expect(page.locator("iframe.preview")).to_be_visible()
    issued = service.requests[-1][2]
    assert issued["verification_job"] == proof
    assert "compensation_id" not in issued  # the service takes those of the proof


def test_the_files_that_were_verified_go_into_the_certificate(panel, service):
    page = panel.open("#/records")
    for driven_with, stated in (
        ("heidenhain-10-hold", "heidenhain-10-hold"),
        (None, ""),
        ("taken-away", ""),
    ):
        result = service.measured()
        service.compensations[result] = [
            scripted_data.compensation(result, name, "hold")
            for name in ("linuxcnc", "heidenhain")
        ]
        asked = {"result_id": result, "compensation_id": driven_with}
        service.verified(verification(result) | {"asked": asked})
        go(page, "#/records")
        rows = page.locator("tbody").first.locator("tr")
        expect(rows).to_have_count(len(service.jobs))
        go(page, f"#/certificate/{result}")
        files = page.get_by_label("Files that the control corrects by")
        expect(files).to_have_value(stated)
        follow(page, "Issue the certificate")
        expect(page.locator("iframe.preview")).to_be_visible()
        assert service.requests[-1][2].get("compensation_id", "") == stated


def show_proof(page: Page, service: ScriptedService, **content: Any) -> Locator:
    result = service.measured()
    go(page, f"#/verify/{service.verified(verification(result) | content)}")
    proof = page.locator(".proof")
    expect(proof).to_be_visible()
    return proof


def test_what_a_verification_has_not_seen_or_known_is_said(panel, service):
    page = panel.open("#/records")
    english = ("across the travel", "along X and Y", "Not moved: Z, C.")
    show_proof(
        page,
        service,
        statements=["; ".join(english)],
        components="three at standstills, the two across the travel on lines",
        unseen_directions=["X", "Y"],
        axes_at_rest=["Z", "C"],
        runs=[{"environment": {"refraction": {"by": "nobody"}}, "length_scale_ppm": 2}],
    )
    said = page.locator(".card", has=page.locator(".proof-table")).locator(".lines")
    for language, texts in (
        ("English", english),
        ("Deutsch", ("quer zur Fahrt", "Längs X und Y", "Nicht verfahren: Z, C")),
        ("Deutsch", ("Vorhersage der Maschine: Nicht entsch", "4,00 ppm", "nicht um")),
    ):
        choose(page, language)
        for words in texts:
            expect(said).to_contain_text(words)
    air = Reason("air-uncorrected", "doubtful", {"why": "no pressure"})
    show_proof(page, service, run_verdict=verdict_json(Verdict((air,))))
    band = page.locator(".verdict-band")
    expect(band).to_contain_text("nicht um die Luft korrigiert")


CAUSES = {
    "wrong-sign": "mit dem falschen Vorzeichen ein",
    "not-active": "Die Kompensation ist nicht aktiv",
    "active": "ompens",
}


def test_a_compensation_that_is_not_what_it_is_taken_for_is_said(panel, service):
    page = panel.open("#/records", language="de")
    for cause, words in CAUSES.items():
        scale = {"value": 1.98, "uncertainty": 0.02, "cause": cause}
        said = show_proof(page, service, map_scale=scale).locator(".scale-cause")
        expect_texts(said, words, "1,98")
    # One that explains all sends nobody to the tracker.
    scale = {"value": 0.07, "uncertainty": 0.02, "cause": "active"}
    hopeless = {"consistent": False, "chance_of_any_machine": 0.0}
    agreement = verification("")["agreement"] | hopeless
    proof = show_proof(page, service, map_scale=scale, agreement=agreement)
    said = proof.locator("p", has_text="(k = 2)")
    expect(said).to_contain_text("ompens")
    expect(said).not_to_contain_text("racker")


def test_what_is_stated_of_a_machine_once_is_ready_for_its_certificate(panel, service):
    result = service.measured()
    service.jobs[result]["machine"] = "default"
    service.identity = {"operator": "A. Weiß"}
    page = panel.open("#/machine")
    page.get_by_label("Serial number").fill("4711")
    page.get_by_role("button", name="Save").click()
    expect(page.locator("[data-machine]")).to_contain_text("no. 4711")
    go(page, f"#/certificate/{result}")
    stated = page.locator("[data-card=stated]")
    serial = stated.get_by_label("Serial number", exact=True)
    expect(serial).to_have_value("4711")
    expect(stated.get_by_label("Measured by")).to_have_value("A. Weiß")
    page.get_by_role("button", name="Deutsch").click()
    follow(page, "Issue the certificate")
    expect(page.locator("[data-card=stated] ~ *")).to_have_count(0)
    expect(page.locator(".kept-list li")).to_contain_text("Deutsch")
    order = service.requests[-1][2]
    assert order["language"] == "de"
    assert order["identity"]["serial_number"] == "4711"


def test_the_tolerance_of_a_machine_is_set_changed_and_taken_away(panel, service):
    page = panel.open("#/machine", language="de", size=PHONE)
    card = page.locator("[data-card=who]")
    tolerance = card.get_by_label("Volumetrische Toleranz")
    save = card.get_by_role("button", name="Speichern")
    tolerance.fill("-3")
    save.click()
    expect(card.get_by_role("alert")).to_contain_text("über 0")
    assert not service.requests
    for text, kept in (("12,5", 12.5), ("", None)):
        tolerance.fill(text)
        with page.expect_response("**/api/v1/machines/*"):
            save.click()
        expect(card.get_by_role("status")).to_have_text("Gespeichert")
        (_, _, sent) = service.requests[-1]
        assert sent["tolerance_um"] == kept
        expect(tolerance).to_have_value(text)
    assert_fits(page)


def test_machines_say_when_calibrated_how_far_off_and_what_is_wrong(panel, service):
    service.machines = [machine_entry("mill-3"), machine_entry("mill-4", name="Five")]
    service.histories["mill-3"] = machine_history("mill-3", "2026-03-01T08:00:00.000Z")
    alarm = {"is_alarm": True, "tolerance": "over", "reference_job": None}
    service.standings["mill-3"] = EXAMPLES["get_machine_standing"] | alarm
    page = panel.open("#/machine")
    mill = page.locator("[data-machine=mill-3]")
    expect(mill).to_contain_text("Mar 1, 2026")
    expect(mill).to_contain_text(re.compile(r"\d+ (days|h) ago|hour ago"))
    expect(mill).to_contain_text("26.0 ± 0.4 µm")
    expect(mill.locator("[data-standing=alarm]")).to_contain_text("Over its tolerance")
    other = page.locator("[data-machine=mill-4]")
    expect(other).to_contain_text("never")
    expect(other.locator("[data-standing=unknown]")).to_be_visible()


def test_a_machine_is_added_from_its_file_and_described_anew(panel, service):
    add, most, save = "Maschine hinzufügen", "X, größter Wert", "Spei"
    page = panel.open("#/machine", size=PHONE, language="de")
    panel.witness.expect("409")
    page.locator("[data-card=add] summary").click()
    form = page.locator("[data-form=add]")

    def choose(text):
        file = {"name": "mill.json", "mimeType": "application/json", "buffer": text}
        form.locator("input[type=file]").set_input_files(file)

    choose(b"{}")
    expect(form.get_by_role("alert")).to_contain_text("mill.json")
    content = {**copy.deepcopy(MACHINE), "name": "VMC 700"}
    choose(json.dumps(content).encode())
    form.get_by_label(most).fill("612,5")
    form.locator("#add-id").fill("default")
    form.get_by_role("button", name=add).click()
    expect(form.get_by_role("alert")).not_to_be_empty()
    form.locator("#add-id").fill("mill-5")
    form.get_by_role("button", name=add).click()
    expect(page.locator("[data-machine=mill-5]")).to_contain_text("VMC 700")
    sent = service.requests[-1][2]
    content["axes"]["X"]["max_mm"] = 612.5
    assert sent == {"id": "mill-5", "machine_file": content}
    expect(page.locator("[data-card=devices]")).to_be_visible()
    page.locator("[data-card=describe] summary").click()
    changed = page.locator("[data-form=describe]")
    expect(changed.get_by_label(most)).to_have_value(re.compile("612.5"))
    changed.get_by_label(most).fill("700")
    changed.get_by_label("Höhe des Stand").fill("120")
    assert_fits(page)
    changed.get_by_role("button", name=save).click()
    expect(page.locator("[data-card=describe] form")).to_be_hidden()
    method, path, sent = service.requests[-1]
    assert (method, path) == ("PUT", "/machines/mill-5/machine-file")
    assert sent["machine_file"]["axes"]["X"]["max_mm"] == 700
    assert sent["machine_file"]["site"] == {"altitude_m": 120}
    assert sent["machine_file"]["tool_offset_mm"] == content["tool_offset_mm"]


def test_a_machine_is_removed_by_a_held_button_and_a_refusal_is_said(panel, service):
    own = {"name": "VMC 700", "origin": "catalogue", "cell": "none"}
    service.machines = [machine_entry(), machine_entry("mill-5", **own)]
    service.held_machine = "mill-5"
    panel.witness.expect("409")
    page = panel.open("#/machine", size=PHONE, language="de")
    expect(page.locator("[data-card=who]")).to_be_visible()
    expect(page.locator("[data-card=remove]")).to_have_count(0)  # of the settings
    page.locator("[data-machine=mill-5] button").click()
    card = page.locator("[data-card=remove]")
    card.locator("summary").click()
    expect_texts(card, "Kalibrierscheine und ihr Verlauf bleiben", "mill-5")
    assert_fits(page)
    button = card.locator("#machine-remove")
    button.click()  # a touch is not enough
    hold_until_answered(page, button)
    expect(card.get_by_role("alert")).to_contain_text("job-7 (running) holds")
    sent = [one for one in service.requests if one[0] == "DELETE"]
    assert sent == [("DELETE", "/machines/mill-5", '"3"')]
    service.held_machine = ""
    hold_until_answered(page, button)
    removed = page.locator("[role=status]", has_text="VMC 700 ist entfernt")
    expect(removed).to_be_visible()
    expect(page.locator("[data-machine]")).to_have_count(1)
    expect(card).to_have_count(0)


def hold_until_answered(page: Page, button: Locator) -> None:
    is_asked = page.expect_response(lambda answer: answer.request.method == "DELETE")
    with held(page, button), is_asked:
        pass


def test_a_phone_shows_where_one_is_and_what_comes_next(panel, service):
    result = service.measured()
    page = panel.open(f"#/export/{result}", size=PHONE, touch=True)
    steps = page.locator(".step:visible")
    for language in ("English", "Deutsch"):
        choose(page, language)
        expect(steps).to_have_count(3)
        expect(page.locator(".step:visible [aria-current=step]")).to_have_count(1)
        expect(page.locator(".group-name:visible")).to_have_count(4)
        assert_fits(page)
        small = "#main button, #main select, .step:visible > a, .group-name"
        boxes = [one.bounding_box() for one in page.locator(small).all()]
        assert min(box["height"] for box in boxes if box) >= 48
    steps.nth(1).click()
    page.wait_for_url(f"**/#/verify/{result}")


def test_who_is_no_metrologist_sees_results_files_and_certificates_only(panel, service):
    result = service.measured()
    service.log_in_required, service.user = True, ("olga", "operator")
    page = panel.open(f"#/export/{result}")
    expect(page.locator("[data-card=export]")).to_be_hidden()
    expect(page.locator("#main")).to_contain_text("Only a metrologist does this")
    go(page, f"#/result/{result}")
    expect(page.locator("[data-card=map]")).to_be_visible()
    expect(page.locator("[data-card=reference]")).to_be_hidden()
    go(page, f"#/certificate/{result}")
    expect(page.locator("#reason")).to_contain_text("Only a metrologist does this")
    expect(page.locator(NEXT)).to_have_count(0)


def test_of_several_machines_the_chosen_one_is_connected_and_measured(panel, service):
    service.machines = [machine_entry("mill-3"), machine_entry("mill-4", name="Five")]
    page = panel.open()
    page.wait_for_url("**/#/machine")
    page.locator("[data-machine=mill-4]").get_by_role("button", name="Choose").click()
    chosen = page.locator("[data-machine=mill-4] [aria-pressed=true]")
    expect(chosen).to_have_text("Chosen")
    follow(page, "To the devices")
    follow(page, "Connect devices")
    expect(page.locator("#machine-name")).to_have_text("Five")
    follow(page, "Prepare the run")
    page.wait_for_url("**/#/check/*")
    assert ("POST", "/machines/mill-4:connect", None) in service.requests
    order = service.requests[-1][2]
    assert (order["kind"], order["machine"]) == ("measure-otf", "mill-4")


def test_records_are_searched_by_text_and_kind_and_two_are_compared(panel, service):
    service.measured()
    later = service.measured()
    service.new_job("discover", state="failed")
    service.histories["default"] = machine_history("default", "2026-03-14T08:00:00Z")
    page = panel.open("#/records")
    rows = page.locator("tbody").first.locator("tr")
    expect(rows).to_have_count(3)
    page.get_by_label("Look for").fill("15.3")
    expect(rows).to_have_count(1)
    expect(rows).to_contain_text("15.3 ± 0.2 µm")
    page.get_by_label("Look for").fill("")
    rows.nth(1).get_by_label("Name of On the fly").fill("As found")
    rows.nth(1).get_by_label("Name of On the fly").press("Enter")
    page.get_by_label("Look for").fill("as found")
    expect(rows).to_have_count(1)
    assert service.jobs[later]["name"] == "As found"
    page.get_by_label("Look for").fill("")
    page.get_by_label("Method").select_option("measure-otf")
    expect(rows).to_have_count(2)
    for number in range(2):
        rows.nth(number).get_by_role("button", name="Compare").click()
    expect(page.locator("table.compare")).to_be_visible()
    expect(page.locator("h3", has_text="As found, compared with")).to_be_visible()


def test_drivers_are_chosen_and_tried_without_a_text_editor(panel, service):
    service.machines = [machine_entry(origin="catalogue", devices={})]
    page = panel.open("#/connect")
    card = page.locator("[data-card=devices]")
    tracker, control = (
        card.locator(f"[data-device={w}]") for w in ("tracker", "motion")
    )
    expect(tracker.get_by_label("Laser tracker")).to_have_value("streaming")
    tracker.get_by_label("host").fill("192.0.2.7")
    tracker.get_by_label("port").fill("5000")
    tracker.get_by_text("More options").click()
    tracker.get_by_label("turn_s").fill("12.5")
    control.get_by_label("port").fill("502")
    card.get_by_role("button", name="Save the drivers").click()
    card.get_by_role("button", name="Try the tracker").click()
    expect(card.get_by_role("status")).to_contain_text(
        "6,233 samples, 0 lost, target 0.5 m away"
    )
    (devices,) = [body for method, _, body in service.requests if method == "PUT"]
    assert devices == {
        "tracker_driver": "streaming",
        "tracker_options": {"host": "192.0.2.7", "port": 5000, "turn_s": 12.5},
        "motion_driver": "modbus",
        "motion_options": {"port": 502},
        "thermometer_driver": "",
        "thermometer_options": {},
    }


def test_drivers_of_the_settings_are_only_tried(panel, service):
    page = panel.open("#/connect", language="de")
    card = page.locator("[data-card=devices]")
    expect(card).to_contain_text("in den Einstellungen des Dienstes")
    expect(card.locator("form")).to_have_count(0)
    card.get_by_role("button", name="Tracker erproben").click()
    expect(card).to_contain_text("Reflektor in 0,5 m Abstand")

"""How a machine depends on its temperature, on the page."""

from playwright.sync_api import expect

from page_steps import choose, go
from scripted_data import temperature_dependence

SAID = {
    "English": ("Work it out", "depend on temperature: EXX", "not seen", "11.4 ± 0.6"),
    "Deutsch": ("Berechnen", "Temperatur ab: EXX", "nicht zu sehen", "11,4 ± 0,6"),
}


def test_what_depends_on_temperature_is_said_with_its_uncertainty(panel, service):
    service.measured()
    page = panel.open("#/records")
    card = page.locator("[data-card=dependence]")
    assert service.looks == []
    for language, view in (("English", "records"), ("Deutsch", "trend")):
        ask, answer, unseen, growth = SAID[language]
        service.temperature = temperature_dependence()
        choose(page, language)
        go(page, f"#/{view}")
        card.get_by_role("button", name=ask).click()
        expect(card).to_contain_text(answer)
        expect(card.locator("[data-axis=X]")).to_contain_text(f"{growth} µm/(m·K)")
        first, last = (card.locator("[data-symbol]").nth(i) for i in range(2))
        expect(first).to_contain_text("EXX")
        expect(last).to_contain_text(unseen)
        expect(card.locator(".notice")).to_have_count(0)
        service.temperature["verdict"] = "doubtful"
        card.get_by_role("button", name=ask).click()
        expect(card.locator(".notice.is-held")).to_be_visible()
    assert service.looks == [("temperature", "default")] * 4


def test_calibrations_that_do_not_tell_are_said_so(panel, service, witness):
    witness.expect("422")
    page = panel.open("#/records")
    card = page.locator("[data-card=dependence]")
    card.get_by_role("button", name="Work it out").click()
    expect(card.locator(".notice")).to_contain_text("The calibrations do not tell")
    expect(card.locator(".notice")).to_contain_text("2 of 3 temperatures")
    service.temperature_refusal = (
        "the results are at 2 different temperatures (20.1, 20.3, 24.0 °C; less than "
        "0.5 K apart counts as one): measure at three or more"
    )
    choose(page, "Deutsch")
    card.get_by_role("button", name="Berechnen").click()
    said = card.locator(".notice")
    expect(said).to_contain_text("bei 2 verschiedenen Temperaturen")
    expect(said).to_contain_text("(20,1; 20,3; 24,0 °C; weniger als 0,5 K")
    expect(said).not_to_contain_text("measure")

"""The interactive documentation in a real browser, under the service's own policy."""

import os
import shutil

import pytest
from playwright.sync_api import expect, sync_playwright

pytestmark = pytest.mark.ui


@pytest.fixture
def page():
    with sync_playwright() as playwright:
        found = os.environ.get("CHROMIUM") or shutil.which("chromium")
        browser = playwright.chromium.launch(executable_path=found)
        page = browser.new_page()
        yield page
        browser.close()


def test_the_documentation_works_without_any_other_host(page, live):
    complaints, hosts = [], set()
    page.on("console", lambda m: m.type == "error" and complaints.append(m.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("request", lambda request: hosts.add(request.url.split("/")[2]))
    page.goto(f"{live.base_url}/docs")
    operation = page.locator("#operations-jobs-create_job")
    expect(operation).to_be_visible(timeout=15_000)
    operation.locator(".opblock-summary-control").click()
    expect(operation.get_by_text("idempotency-key", exact=True)).to_be_visible()
    page.locator("#operations-system-get_system .opblock-summary-control").click()
    page.locator("#operations-system-get_system .execute").click()
    answer = page.locator("#operations-system-get_system .live-responses-table")
    expect(answer).to_contain_text('"version": "1.2.3"')
    assert complaints == []
    assert {host for host in hosts if host} == {live.base_url.netloc.decode()}

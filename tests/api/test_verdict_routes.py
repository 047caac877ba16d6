"""A result that is not simply usable says so in its job, its tables and its file."""

import pytest

from truepath.files.earlier.verdict import Reason, Verdict, verdict_json

OPEN = Reason("loop-open", "doubtful", {"distance_um": 9.0, "limit_um": 3.0})
BEYOND = Reason("fit-beyond-noise", "not-usable", {"ratio": 3.5, "limit_ratio": 1.3})


@pytest.fixture
def judged(armed, make_cell, until, science):
    """End a job with a result of a verdict."""

    def finish(verdict):
        science.verdict = verdict
        make_cell.cell.end()
        return until(armed, "succeeded")

    return finish


@pytest.mark.parametrize("reasons", [(), (OPEN,), (OPEN, BEYOND)])
def test_a_job_succeeds_and_says_the_state_of_its_result(client, judged, reasons):
    verdict = Verdict(reasons)
    job = judged(verdict)
    assert (job["state"], job["verdict"]) == ("succeeded", verdict.state)
    (listed,) = client.get("/api/v1/jobs").json()["items"]
    assert listed["verdict"] == verdict.state
    tables = client.get(job["result"]["error_tables_json"]).json()
    assert tables["verdict"] == verdict_json(verdict)
    assert client.get(job["result"]["result"]).json()["verdict"] == tables["verdict"]


def test_a_job_without_a_result_has_no_verdict(ready):
    assert ready["verdict"] is None


def test_a_table_that_is_not_to_be_used_is_given_out_only_if_accepted(
    client, judged, is_problem
):
    address = judged(Verdict((OPEN, BEYOND)))["result"]["error_tables_csv"]
    refusal = is_problem(client.get(address), 422, "not-usable")
    assert "is not to be used: " in refusal["detail"]
    assert str(OPEN) in refusal["detail"]
    assert str(BEYOND) in refusal["detail"]
    assert "accept_verdict=true" in refusal["action"]
    accepted = client.get(address, params={"accept_verdict": "true"})
    assert accepted.status_code == 200
    assert accepted.text.startswith("error,position_mm")


@pytest.mark.parametrize("reasons", [(), (OPEN,)])
def test_a_table_that_may_be_used_is_given_out(client, judged, reasons):
    job = judged(Verdict(reasons))
    assert client.get(job["result"]["error_tables_csv"]).status_code == 200


def test_a_result_of_an_earlier_version_says_nothing_against_itself(
    client, service, finished
):
    file = service.results / finished["id"] / "result.json"
    file.write_text('{"machine": {}, "error_tables": {}, "squareness_urad": {}}')
    tables = client.get(finished["result"]["error_tables_json"]).json()
    assert tables["verdict"]["state"] == "usable"
    assert client.get(finished["result"]["error_tables_csv"]).status_code == 200

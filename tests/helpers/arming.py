"""Arming in its two steps: ask what will move, then arm with the token."""


def request_token(client, job_id):
    answer = client.post(f"/api/v1/jobs/{job_id}/arming")
    assert answer.status_code == 200, answer.text
    return answer.json()["token"]


def arm_over_http(client, job):
    return client.post(
        f"/api/v1/jobs/{job['id']}/arm",
        headers={"If-Match": f'"{job["version"]}"'},
        json={"token": request_token(client, job["id"])},
    )


def arm_at_once(dispatcher, job_id, version, *, by=None):
    """Arm a job at a version by the dispatcher itself; return the job."""
    token = dispatcher.prepare_arming(job_id, by=by).token
    return dispatcher.arm(job_id, version, token, by=by)

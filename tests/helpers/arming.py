"""Arming in its two steps: ask what will move, then arm with the token."""


def arm_over_http(client, job):
    address, version = f"/api/v1/jobs/{job['id']}/arm", f'"{job["version"]}"'
    asked = client.post(f"{address}ing")
    assert asked.status_code == 200, asked.text
    token = {"token": asked.json()["token"]}
    return client.post(address, headers={"If-Match": version}, json=token)


def arm_at_once(dispatcher, job_id, version, *, by=None):
    """Arm a job at a version by the dispatcher itself; return the job."""
    token = dispatcher.prepare_arming(job_id, by=by).token
    return dispatcher.arm(job_id, version, token, by=by)

"""The asynchronous client against the application over a scripted cell."""

from __future__ import annotations

import asyncio

import httpx2
import pytest

from truepath.client import AsyncClient, Busy, JobEnded, StaleVersion
from truepath.service.api.application import create_application

PATH = [
    {"x_mm": 10, "y_mm": 10, "z_mm": 10},
    {"x_mm": 400, "y_mm": 300, "z_mm": 200},
    {"x_mm": 100, "y_mm": 350, "z_mm": 50},
]


def test_a_job_is_created_armed_and_aborted(service):
    async def measure():
        transport = httpx2.ASGITransport(create_application(service))
        async with AsyncClient("http://127.0.0.1", transport=transport) as client:
            await client.connect()
            order = await client.create_job(kind="measure-otf", path=PATH)
            job = await client.wait_for(
                order["id"], "ready", timeout_s=30, period_s=0.02
            )
            with pytest.raises(Busy) as busy:
                await client.create_job(kind="measure-otf")
            assert busy.value.current_job == job["links"]["self"]
            with pytest.raises(StaleVersion):
                await client.arm({**job, "version": job["version"] - 1})
            assert (await client.arm(job))["state"] == "running"
            await client.abort(job["id"])
            with pytest.raises(JobEnded, match="aborted"):
                await client.wait_for(job["id"], timeout_s=30, period_s=0.02)
            return [each["state"] async for each in client.list_jobs()]

    assert asyncio.run(measure()) == ["aborted"]


def test_events_are_followed_until_the_job_has_ended(live):
    async def follow():
        states = []
        async with AsyncClient(str(live.base_url)) as client:
            order = await client.create_job(kind="measure-otf", path=PATH)
            async for event in client.events(order["id"]):
                if event.type != "job":
                    continue
                states.append(event.data["state"])
                # A job that stands ready is told again where anything of it changes.
                if event.data["state"] == "ready" and states.count("ready") == 1:
                    await client.arm(await client.get_job(order["id"]))
                if event.data["state"] == "running":
                    await client.abort(order["id"])
                if event.data["ended"]:
                    return states

    states = asyncio.run(asyncio.wait_for(follow(), 40))
    assert states[-1] == "aborted"
    assert {"ready", "running"} <= set(states)

"""Grades: what a job's set-up is worth, before anything moves."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import BaseModel, Field

from app.api.problems import declare_problems
from app.api.service import ServiceDep
from app.errors import NotFound
from app.jobs.plans import commanded_from_plan
from app.results.grading import graded

router = APIRouter(prefix="/jobs", tags=["jobs"])

_Place = Annotated[
    list[Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]] | None,
    Query(
        alias="tracker_mm",
        min_length=3,
        max_length=3,
        description="Where the tracker stands: x, y and z, each as a parameter of this "
        "name. Without it four usual places are tried and the worst counts.",
    ),
]


class Thresholds(BaseModel):
    """Numbers up to which a set-up is good, and usable."""

    good: float = Field(examples=[0.25])
    usable: float = Field(examples=[1.0])


class TrackerPlace(BaseModel):
    """Where the tracker stands for this grade."""

    position_mm: list[float]
    assumed: bool = Field(description="Nobody has said so: the worst of usual places.")
    best_number: float = Field(description="At the best of the places.")


class WeakMotionOut(BaseModel):
    """One of the weakest error motions."""

    error: str = Field(examples=["EBZ"])
    meaning: str = Field(examples=["turn of Z about Y"])
    at_tool_um: float = Field(description="Standard uncertainty it puts at the tool.")
    remedy: str | None


class GradeOut(BaseModel):
    """The grade of a set-up from geometry alone; uncertainties are standard ones."""

    number: float = Field(
        examples=[0.11],
        description="Expected uncertainty of the map over the scatter of one sample.",
    )
    verdict: str = Field(examples=["good"], description="good, usable or poor")
    thresholds: Thresholds
    text: str
    expected_uncertainty_um: float
    sample_sigma_um: float
    tracker: TrackerPlace
    improved_number: float | None = Field(
        description="With the line that the weakest motion asks for."
    )
    weakest: list[WeakMotionOut]
    weak_shapes: list[str]
    unobservable: list[str]


@router.get("/{job_id}/plan/grade", responses=declare_problems(404, 422))
def get_plan_grade(
    job_id: str, service: ServiceDep, tracker_mm: _Place = None
) -> GradeOut:
    """Grade what a measuring job commands, from geometry alone, before it is armed."""
    job = service.store.get(job_id)
    plan = service.store.read_plan(job.id)
    if plan is None:
        raise NotFound(f"job {job_id} ({job.kind}) commands nothing to be graded")
    if service.machine is None:
        raise NotFound("the service has no machine file to grade the plan with")
    found = graded(
        service.machine,
        commanded_from_plan(plan),
        tracker_mm=tracker_mm,
        perpendicular_only=job.perpendicular_only,
    )
    return GradeOut(**found)

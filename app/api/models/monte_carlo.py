"""Monte Carlo trials that an analysis is held against."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field

from app.api.models.base import RequestBody
from app.numerics.adaptive_trials import TrialPlan


class MonteCarlo(RequestBody):
    """Trials of JCGM 101 (GUM Supplement 1): the same seed gives the same answer."""

    seed: int = Field(1, ge=0, le=2**53 - 1)
    interval: Literal["symmetric", "shortest"] = Field(
        "symmetric", description="Form of the 95 % coverage intervals."
    )

    def plan(self) -> TrialPlan:
        """Return the trials as the analysis takes them."""
        return TrialPlan(seed=self.seed, interval=self.interval)


class MonteCarloOut(BaseModel):
    """The trials that were asked for."""

    seed: int
    interval: str = Field(examples=["symmetric"])

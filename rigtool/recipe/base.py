"""The base of all models of a recipe: unknown keys are refused, values never change."""

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """One table of a recipe; unknown keys are refused, values are finite and frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

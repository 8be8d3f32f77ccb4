"""``plan.json``: what a manoeuvre can show, what a better one can, and what else to record."""

from typing import Final, Literal

from pydantic import BaseModel, ConfigDict, Field

from hilserver.diagnosis.catalogue.vocabulary import reference
from hilserver.diagnosis.findings.explain import separating_experiment
from hilserver.diagnosis.plan.outlook import Outlook
from hilserver.diagnosis.schema.findings import NotJudged

SCHEMA: Final = "hilserver.plan/1"


class _PlanModel(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


class Visible(_PlanModel):
    """How small an effect of a cause may be."""

    cause: str
    size: float
    unit: str
    reference: float | None = Field(
        description="size at which a diagnosis should name it"
    )
    shows: bool = Field(description="whether it shows at its reference size")


class Group(_PlanModel):
    """Causes that the manoeuvre cannot tell apart at their reference sizes."""

    causes: tuple[str, ...]
    cosine: float = Field(description="smallest |cos| between any two of them")
    separating_experiment: str


class Prospect(_PlanModel):
    """What one manoeuvre can show."""

    duration_s: float
    score: float
    causes: tuple[Visible, ...]
    groups: tuple[Group, ...]
    not_judged: tuple[NotJudged, ...]


class Missing(_PlanModel):
    """What a channel that is not recorded would add to the planned manoeuvre."""

    channel: str
    signals: tuple[str, ...]
    shows: tuple[str, ...]
    separates: tuple[str, ...] = Field(
        description="causes that it removes from every group"
    )


class Proposed(Prospect):
    """The better manoeuvre."""

    better: bool = Field(
        description="false: nothing better was found; the scenario is as planned"
    )
    pieces: tuple[str, ...]
    scenario: str


class PlanDocument(_PlanModel):
    """``plan.json``."""

    schema_: Literal["hilserver.plan/1"] = Field(default=SCHEMA, alias="schema")
    version: str
    config_sha256: str
    seed: int
    manoeuvre: str
    channels: tuple[str, ...]
    rate_hz: float
    navigation_hz: float
    satellites_m: float | None = Field(
        default=None,
        description="standard deviation of a position by satellites; null: by a usual navigation",
    )
    room_m: tuple[float, float]
    as_planned: Prospect
    proposed: Proposed
    missing_channels: tuple[Missing, ...]
    notices: tuple[str, ...] = ()


def prospect(outlook: Outlook, duration_s: float) -> Prospect:
    """Return an outlook in the form of the document."""
    return Prospect(
        duration_s=round(duration_s, 3),
        score=round(outlook.score, 3),
        causes=tuple(
            Visible(
                cause=cause,
                size=found.size,
                unit=found.unit,
                reference=reference(cause, cause),
                shows=cause in outlook.shown,
            )
            for cause, found in outlook.sizes.items()
        ),
        groups=tuple(
            Group(
                causes=group,
                cosine=min(
                    c for pair, c in outlook.pairs.items() if set(pair) <= set(group)
                ),
                separating_experiment=separating_experiment(group),
            )
            for group in outlook.groups
        ),
        not_judged=tuple(
            NotJudged(cause=cause, reason=reason)
            for cause, reason in outlook.not_judged.items()
        ),
    )

"""Which causes a log can judge by its channels, and why others are not judged."""

from collections.abc import Mapping
from typing import Final

from hilserver.diagnosis.catalogue.candidate import Candidate, StageName
from hilserver.diagnosis.catalogue.needs import NOT_OF_ITS_OWN, lacking
from hilserver.diagnosis.catalogue.vocabulary import CAUSES
from hilserver.diagnosis.replay.stage import Stage
from hilserver.measured.channels import POSITION
from hilserver.measured.data import MeasuredLog

NO_STAGE: Final[Mapping[StageName, str]] = {
    "drive": "no set-points with wheel speeds, or the mapping gives no plant.process",
    "pose": "no pose and no turn rate in the log, or no wheel speed of both sides",
}
"""Why causes are not judged whose stage the log does not allow."""


def judged_candidates(stage: Stage) -> tuple[list[Candidate], dict[str, str]]:
    """Return the candidates that a stage's channels can judge, and why others are not judged."""
    found = stage.candidates()
    reasons = lacking(stage.missing(), found)
    return [c for c in found if c.cause not in reasons], reasons


def splits(log: MeasuredLog, candidate: Candidate) -> bool:
    """Return whether a region of the floor holds a fair part of the drive, but not all of it."""
    if candidate.cause != "surface_change":
        return True
    t = candidate.terms(candidate.start)
    x, y = (log[n].values for n in POSITION)
    if len(x) != len(y):
        return False
    inside = (x >= t["surface_change.x_min"]) & (x <= t["surface_change.x_max"])
    inside &= (y >= t["surface_change.y_min"]) & (y <= t["surface_change.y_max"])
    return bool(0.15 < inside.mean() < 0.85)


def vocabulary_reasons(
    judged: set[str], reasons: dict[str, str], stages: set[str]
) -> dict[str, str]:
    """Return a reason for every physical cause that was not judged, in the vocabulary's order."""
    out = dict(reasons)
    for name, cause in CAUSES.items():
        if name in judged or name in out:
            continue
        if name in NOT_OF_ITS_OWN:
            out[name] = NOT_OF_ITS_OWN[name]
            continue
        if not cause.physical:
            continue
        if cause.stage not in stages:
            out[name] = NO_STAGE[cause.stage]
    order = {name: place for place, name in enumerate(CAUSES)}
    left = sorted(out.keys() - judged, key=lambda name: (order.get(name, len(order)), name))
    return {name: out[name] for name in left}

"""Tyres that scrub: when a smaller rotation gain may be friction across the wheels.

In steady turns the two are exact twins (`hilserver.plant.friction`). But a gain alone cannot make
the turn late: tyres give before they pull, so the body follows the wheels some milliseconds later.
Real skid-steered robots turn at about half of 1/track: unless a log shows that the turn is on time,
it does not tell a gain from friction.
"""

from collections.abc import Iterable, Sequence
from typing import Final

from scipy.optimize import brentq

from hilserver.diagnosis.catalogue.traits import traits_of
from hilserver.diagnosis.decide.structure import Unknown
from hilserver.diagnosis.regression.columns import Library
from hilserver.diagnosis.regression.fitting import fit_without
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.replay.model import Fitted
from hilserver.diagnosis.schema.findings import Parameter
from hilserver.diagnosis.thresholds import (
    INEXACT,
    RIVAL_CLEAR_Z,
    SCRUBBING_LATE_S,
    SCRUBBING_MUCH,
    SCRUBBING_SOON_S,
)
from hilserver.measured.channels import POSITION, YAW
from hilserver.plant.friction import anisotropy
from hilserver.plant.parameters import RobotParameters

RATIOS: Final = (0.2, 20.0)
"""Range in which the ratio of friction across to friction along the wheels is searched."""
TURNING = "velocity.angular_rad_s"


def scrubs(problem: Problem, point: Point, unknown: Sequence[Unknown]) -> bool:
    """Return whether the turn is much smaller than by the wheels, and late or irregular."""
    seen = problem.stage.log.has(*POSITION, YAW)
    if not seen or not _turns_less(problem, point.model.fitted):
        return False
    irregular = bool(unknown) and unknown[0].family.regressors[0] == TURNING
    return irregular or late_turn(point) is not None


def may_scrub(library: Library, point: Point, rivals: Iterable[Fitted]) -> bool:
    """Return whether the turn is much smaller than by the wheels, and may be late.

    Parameters
    ----------
    rivals : iterable of Fitted
        Causes that tie with those of the model.
    """
    if not _turns_less(library.problem, (*point.model.fitted, *rivals)):
        return False
    return late_turn(point) is not None or not is_on_time(library, point)


def _turns_less(problem: Problem, fitted: Iterable[Fitted]) -> bool:
    robot = problem.stage.robot
    if robot.wheelbase_m is None or robot.is_mecanum:
        return False
    gains = (f for f in fitted if traits_of(f.candidate.cause).scrubs_as)
    return any(gain.theta[0] <= SCRUBBING_MUCH for gain in gains)


def is_on_time(library: Library, point: Point) -> bool:
    """Return whether the turn is known to follow the wheels sooner than tyres let it.

    Of all causes that make it late, the one that the log shows best decides.
    """
    scores, known = library.scores(point), []
    for k, owner in enumerate(library.owner.tolist()):
        c = library.candidates[owner]
        if traits_of(c.cause).delays_turn and c.linear and scores.information[k] > 0.0:
            sd_s = float(scores.deviation[k] / scores.information[k])
            known.append((sd_s, float(scores.size[k])))
    if not known:
        return False
    sd_s, late_s = min(known)
    return late_s + RIVAL_CLEAR_Z * sd_s < SCRUBBING_SOON_S


def late_turn(point: Point) -> int | None:
    """Return the index of a latency of the turn that is short enough to come from the tyres."""
    for index, f in enumerate(point.model.fitted):
        if (
            traits_of(f.candidate.cause).delays_turn
            and 0.0 < f.theta[0] < SCRUBBING_LATE_S
        ):
            return index
    return None


def bent_turn(problem: Problem, point: Point, explained: float) -> int | None:
    """Return the index of a cause that only makes up the small difference between tyres and a gain.

    Parameters
    ----------
    explained : float
        Deviance that all causes save together.
    """
    for index, cause in enumerate(point.model.causes):
        if traits_of(cause).bends_turn:
            less = fit_without(problem, point, index)
            if less.deviance - point.deviance < INEXACT * explained:
                return index
    return None


def as_friction(
    robot: RobotParameters, gain: Fitted, own: Parameter
) -> Parameter | None:
    """Return the ratio of friction across to along that turns the robot as the rotation gain does.

    None if no ratio does.
    """
    assert robot.wheelbase_m is not None
    even = robot.track_m / (robot.wheelbase_m**2 + robot.track_m**2)

    def ratio(a: float) -> float:
        wanted = (1.0 + a) * robot.k_om / even
        return float(
            brentq(
                lambda r: (
                    anisotropy(robot.wheelbase_m or 0.0, robot.track_m, r, 0.0)[0]
                    - wanted
                ),
                *RATIOS,
                xtol=1e-4,
            )
        )

    try:
        ends = sorted(ratio(a) for a in own.ci95 or (gain.theta[0],) * 2)
        return Parameter(value=ratio(gain.theta[0]), ci95=(ends[0], ends[1]), unit="1")
    except ValueError:
        return None

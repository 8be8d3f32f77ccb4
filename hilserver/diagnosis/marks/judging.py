"""What marks on the floor say about a robot: findings, gain and what they cannot show."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from hilserver.arrays import Array, Indices
from hilserver.diagnosis.catalogue.library import pose_candidates
from hilserver.diagnosis.catalogue.vocabulary import CAUSES, unit_of
from hilserver.diagnosis.findings.outcome import fitted_finding, parameters_of
from hilserver.diagnosis.marks.runs import MarkedRuns, rows_of
from hilserver.diagnosis.marks.search import (
    BY_CHANCE,
    FEWEST_FREEDOM,
    FEWEST_MARKED_RUNS,
    SIZE,
    MarksSearch,
    MarksTrial,
)
from hilserver.diagnosis.marks.slip import RandomSlip
from hilserver.diagnosis.regression.gain import Errors, compare
from hilserver.diagnosis.regression.stages import stages_of
from hilserver.diagnosis.replay.model import Fitted, Model
from hilserver.diagnosis.replay.pose_stage import PoseStage
from hilserver.diagnosis.schema.evidence import MarkedEnds
from hilserver.diagnosis.schema.findings import Detectable, Finding, Gain
from hilserver.measured.data import MeasuredLog
from hilserver.plant.parameters import RobotParameters

DIMENSIONS_SHOWN: Final = (
    "wheel_radius",
    "wheel_radius_difference",
    "rotation_gain",
    "icr_offset",
    "wheel_misalignment",
)
"""Dimensions of a robot, which move the place where a run ends; few numbers show no more."""

WITH_HEADING: Final = frozenset({"icr_offset", "wheel_misalignment"})
"""Without a marked heading these stand for whatever else bends a run a little."""

BEYOND_MARKS: Final = (
    "marks say where the robot came to, not when or how: they show dimensions"
)
NO_DIRECTION: Final = (
    "are not used: they end near their first mark, and nobody knows in which direction; mark the"
    " heading in which they began (yaw_rad), or drive back onto the mark (same_as_t_s)"
)
A_SIDE: Final = (
    "Measure a long straight part of the runs with the tape as well, and mark it (from_t_s with"
    " forward_m)."
)
TOO_FEW: Final = "no marks of enough runs"
UNEXPLAINED: Final = "no dimension explains where the runs end"
TOO_WEAK: Final = "hardly excited: the marks of these runs cannot show it"
FOLDS: Final = 5  # halves of six runs would be too few to select from
FAR_FROM_MARKS_SD: Final = 4.0  # misses in standard deviations of the marks
FAR_SHARE: Final = 0.2  # of how far a run goes
ALIKE_SHARE: Final = 0.05  # the same where all runs of one direction miss alike
ALIKE_SD: Final = 4.0  # their mean miss in deviations of their own
FEWEST_ALIKE: Final = 3
# a run does not fit if it misses so many times as far as all others, and at most one in so many
ALONE_TIMES: Final = 3.0
MOST_ALONE: Final = 4
STEP_S: Final = 0.01  # of the replay: where a run ends depends on nothing faster
MISFIT: Final = 2.0  # misses in what the marks' standard deviations explain


@dataclass(frozen=True)
class ByMarks:
    """The part of a diagnosis that rests on marks."""

    findings: tuple[Finding, ...] = ()
    fitted: tuple[Fitted, ...] = ()  # of each finding
    smallest: tuple[Detectable, ...] = ()
    reasons: dict[str, str] = field(default_factory=dict)
    gain: dict[str, Gain] = field(default_factory=dict)
    notices: tuple[str, ...] = ()
    ends: MarkedEnds | None = None
    # lowest and highest speed and turn rate of the runs
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def judge_marks(
    log: MeasuredLog,
    robot: RobotParameters,
    terms: Mapping[str, float],
    rng: np.random.Generator,
    report: Callable[[str, float], None],
) -> ByMarks:
    """Judge the motion of a robot by the marks of its log.

    Parameters
    ----------
    terms : mapping of str to float
        What is known of the drive, for wheels whose speeds were not measured.
    """
    if not log.marks:
        return ByMarks()
    stage = whole_runs(log, robot, terms)
    if stage is None:
        return ByMarks(
            notices=("the marks are not used: no wheel speed on both sides",)
        )

    runs = MarkedRuns(stage)
    meaningless = robot.meaningless
    headed = any(m.mark.yaw_rad is not None for m in log.marks)
    candidates = [
        c
        for c in pose_candidates(None)
        if c.label in DIMENSIONS_SHOWN
        and c.cause not in meaningless
        and (c.cause not in WITH_HEADING or headed)
    ]
    informing = np.flatnonzero(runs.freedom > 0)
    reasons = {
        n: BEYOND_MARKS for n, c in CAUSES.items() if c.physical and c.stage == "pose"
    }
    if not headed:
        reasons |= dict.fromkeys(WITH_HEADING, "no mark has a heading (yaw_rad)")
    reasons |= meaningless
    freedom = int(runs.freedom.sum()) - len(candidates)
    if len(informing) < FEWEST_MARKED_RUNS or freedom < FEWEST_FREEDOM:
        text = (
            f"{len(informing)} runs with marks of more than their beginning are too few: mark the"
            f" start and the end of {max(FEWEST_MARKED_RUNS, len(candidates))} or more"
        )
        few = dict.fromkeys((c.cause for c in candidates), TOO_FEW)
        return ByMarks(reasons=reasons | few, notices=(text, *lost_runs(runs)))

    search = MarksSearch(runs, RandomSlip(runs), candidates, informing, report)
    return searched(search, reasons, rng)


def searched(
    search: MarksSearch, reasons: dict[str, str], rng: np.random.Generator
) -> ByMarks:
    """Return what a search finds; `reasons` lose the causes that it judges."""
    runs, candidates = search.runs, search.candidates
    nothing = search.trial(Model())
    shown = [one for one in candidates if search.shows(nothing, one)]
    trial = nothing
    if shown:
        search = replace(search, candidates=shown)
        trial = search.select()
    model = trial.model
    far = far_off(search, model)
    said = (*fit_of(search, Model() if far else model), *lost_runs(runs))
    if far:
        reasons |= dict.fromkeys((c.cause for c in candidates), UNEXPLAINED)
        ends = MarkedEnds(drawn(runs, Model()), None)
        return ByMarks(reasons=reasons, notices=(far, *said), ends=ends)
    if not shown:
        few = dict.fromkeys((c.cause for c in candidates), TOO_WEAK)
        return ByMarks(reasons=reasons | few, notices=said)

    found = findings_by_marks(search, trial)
    smallest = smallest_by_marks(search, trial)
    unseen = {c.cause for c in candidates} - {one.cause for one in smallest}
    reasons |= dict.fromkeys(unseen, TOO_WEAK)
    for one in smallest:
        reasons.pop(one.cause, None)
    for finding in found:
        for cause in finding.causes:
            reasons.pop(cause, None)
    return ByMarks(
        tuple(found),
        model.fitted,
        smallest,
        reasons,
        {"position_m": gain_by_marks(search, rng)},
        (notice_of(search), *said),
        MarkedEnds(drawn(runs, Model()), drawn(runs, model) if model.fitted else None),
        ranges_of(runs.stage),
    )


def far_off(search: MarksSearch, model: Model) -> str:
    """Return what to say where a model leaves runs far from their marks; or nothing.

    It does so if they miss by a good part of their length, or by less but alike, which slip would
    not do, or end no nearer than those of the configured robot. Then neither a cause nor "nothing
    found" would be true.
    """
    runs, chosen = search.runs, search.chosen
    before_m, after_m = (
        float(_miss_m(runs, one)[chosen].mean()) for one in (Model(), model)
    )
    residual = runs.residual(model.terms)
    course, first = runs.course({}), runs.stage.segments.first
    extents_m = []
    for run in chosen:
        segment = runs.segments[run]
        x_m, y_m, _ = (course[first[segment] : first[segment + 1]]).T
        extents_m.append(float(np.hypot(x_m - x_m[0], y_m - y_m[0]).max()))
    by_sd = float(np.mean(residual[rows_of(runs, chosen)] ** 2))
    length_m = float(np.median(extents_m))
    most = ALIKE_SHARE if miss_alike(search, model) else FAR_SHARE
    is_far = by_sd > FAR_FROM_MARKS_SD**2 and after_m > most * length_m
    is_nearer = not model.fitted or after_m < before_m
    if is_nearer and not is_far:
        return ""
    return (
        f"no dimension explains why the runs end {before_m:.2g} m from their marks: check plant:"
        " (or --robot) and the marks (in metres, x_m along the line, y_m to its left), correct"
        " what is clearly wrong, and diagnose again"
    )


def miss_alike(search: MarksSearch, model: Model) -> bool:
    """Return whether the runs of one direction miss their marks by the same way."""
    runs, chosen = search.runs, search.chosen
    ends, course = runs.ends(model.terms)[chosen], runs.course({})
    last = runs.stage.segments.first[np.array(runs.segments)[chosen] + 1] - 1
    for way in (-1.0, 1.0):
        own = ends[(np.sign(course[last, 2]) == way) & ~np.isnan(ends[:, 0])]
        if len(own) < FEWEST_ALIKE:
            continue
        mean = own.mean(axis=0)
        scatter_m = np.sqrt(np.sum((own - mean) ** 2) / (len(own) - 1))
        if np.hypot(*mean) > ALIKE_SD * scatter_m:
            return True
    return False


def unlike_others(search: MarksSearch, model: Model) -> Indices:
    """Return the runs that end far beyond all others from their marks."""
    runs, chosen = search.runs, search.chosen
    miss_m, exact_m = _miss_m(runs, model)[chosen], runs.ends_sd_m()[chosen]
    order = np.argsort(miss_m)
    for count in range(len(chosen) // MOST_ALONE, 0, -1):
        alone = np.sort(order[-count:])
        far_m = FAR_FROM_MARKS_SD * exact_m[alone]
        least_m = np.maximum(ALONE_TIMES * miss_m[order[-count - 1]], far_m)
        if (miss_m[alone] > least_m).all():
            return np.asarray(chosen[alone])
    return chosen[:0]


def findings_by_marks(search: MarksSearch, trial: MarksTrial) -> list[Finding]:
    """Return one finding per cause of a model, with the rivals that the marks leave possible."""
    found = []
    shown = search.limits(trial) if trial.model.fitted else np.empty((0, 2))
    for index, (fitted, own) in enumerate(zip(trial.model.fitted, shown, strict=True)):
        causes = [fitted.candidate.cause]
        values = parameters_of(fitted, own[None, :])
        for rival in search.rivals(trial, index):
            newest = rival.model.fitted[-1]
            causes.append(newest.candidate.cause)
            values |= parameters_of(newest, search.limits(rival)[-1:])
        finding = fitted_finding(causes, values, BY_CHANCE, drifts=False)
        if SIZE in causes and len(causes) > 1:
            finding = finding.model_copy(update={"separating_experiment": A_SIDE})
        found.append(finding)
    return found


def smallest_by_marks(search: MarksSearch, trial: MarksTrial) -> tuple[Detectable, ...]:
    """Return the smallest effects that would have shown, without those that hardly show."""
    return tuple(
        Detectable(
            cause=candidate.cause,
            size=search.smallest(trial, candidate),
            unit=unit_of(candidate.cause),
        )
        for candidate in search.candidates
        if search.shows(trial, candidate)
    )


def whole_runs(
    log: MeasuredLog, robot: RobotParameters, terms: Mapping[str, float]
) -> PoseStage | None:
    """Return the replay of whole runs, if the log tells how the wheels turned."""
    # `stages_of` makes the stage of the pose only for a channel that shows it: one heading will do
    any_channel = next(iter(log.channels.values()))
    at_start = any_channel.with_values(np.zeros(len(any_channel)))
    shown = log.with_channels({"nav.yaw_rad": at_start})
    stage = stages_of(shown, robot, drive_terms=terms).get(PoseStage.name)
    slices = max(round(STEP_S / robot.period_s), 1)
    return stage.uncut(slices) if isinstance(stage, PoseStage) else None


def ranges_of(stage: PoseStage) -> dict[str, tuple[float, float]]:
    """Return the lowest and the highest speed and turn rate of the runs."""
    ahead = stage.forward_m_s()
    turn = stage.simulate({}, np.zeros((len(stage.segments), 3)))[:, 3]
    return {
        "speed_m_s": (float(ahead.min()), float(ahead.max())),
        "turn_rate_rad_s": (float(turn.min()), float(turn.max())),
    }


def notice_of(search: MarksSearch) -> str:
    """Return what a reader should know of a diagnosis by marks."""
    return (
        f"The motion was judged by the marks of {len(search.chosen)} runs,"
        f" {search.runs.freedom.sum()} numbers besides where the runs began. Marks show what"
        " changes the place where a run ends; they cannot show lags, slip and what a sensor of the"
        " pose would add."
    )


def fit_of(search: MarksSearch, model: Model) -> tuple[str, ...]:
    """Return which runs do not fit to the others, and by how much those scatter too much."""
    runs, alone = search.runs, unlike_others(search, model)
    others = np.setdiff1d(search.chosen, alone)
    miss_m = _miss_m(runs, model)
    said = [
        f"segment {_number(runs, run)} does not fit: it ends {miss_m[run]:.2g} m from its mark, all"
        f" others at most {miss_m[others].max():.2g} m. Check its marks (a sign, x_m and y_m"
        " exchanged, the unit), and leave them out if they are right."
        for run in alone
    ]
    found_m, stated_m = (
        float(np.sqrt(np.mean(one[others] ** 2))) for one in (miss_m, runs.ends_sd_m())
    )
    if model.fitted and found_m > MISFIT * stated_m > 0.0:
        said.append(
            f"The runs end {found_m:.2g} m (RMS) from their marks with all that was found,"
            f" {found_m / stated_m:.1f} times the {stated_m:.2g} m that the standard deviations of"
            " the marks explain: the wheels slip that much, or the marks are less exact than"
            " their sd_m. All intervals allow for it."
        )
    return tuple(said)


def lost_runs(runs: MarkedRuns) -> tuple[str, ...]:
    """Return what a reader should know of runs that show nothing."""
    if not runs.lost:
        return ()
    return (f"{runs.lost} of {len(runs.marks)} runs {NO_DIRECTION}",)


def gain_by_marks(search: MarksSearch, rng: np.random.Generator) -> Gain:
    """Return how much nearer to the marks runs end that took no part in selection and fit."""
    runs, informing = search.runs, search.chosen
    before_m = _miss_m(runs, Model())
    after_m = before_m.copy()
    held = min(FOLDS, len(informing))
    for fold in range(held):
        test = informing[fold::held]
        train = np.setdiff1d(informing, test)
        model = replace(search, chosen=train).select().model
        after_m[test] = _miss_m(runs, model)[test]
    each = np.arange(len(informing))
    first, second = (Errors(one[informing], each) for one in (before_m, after_m))
    return compare(first, second, _lasts_s(runs), rng)


def drawn(runs: MarkedRuns, model: Model) -> Array:
    """Return where a model's runs end, without those whose marks do not say how they began."""
    ends = runs.ends(model.terms)
    return ends[~np.isnan(ends[:, 0])]


def _miss_m(runs: MarkedRuns, model: Model) -> Array:
    """Return how far from its mark each run ends [m], as a tape shows it and the plot draws it.

    Where nobody knows how a run began, it is the root of the mean square of what it misses if it
    begins where it fits best.
    """
    places, count = runs.is_place, len(runs.marks)
    missed_m = runs.residual(model.terms) * runs.sd
    square = np.bincount(runs.run[places], missed_m[places] ** 2, count)
    fitted_m = np.sqrt(square / np.maximum(runs.freedom, 1))
    ends_m = np.hypot(*runs.ends(model.terms).T)
    return np.where(np.isnan(ends_m), fitted_m, ends_m)


def _number(runs: MarkedRuns, run: int) -> int:
    span = runs.stage.segments.span[runs.segments[run]]
    return int(runs.stage.log.spans[span].number_recorded)


def _lasts_s(runs: MarkedRuns) -> float:
    """Return how long the marks of a run are usually apart."""
    lengths = []
    for marks in runs.marks:
        times = [m.t_s for m in marks]
        times += [m.other_t_s for m in marks if m.other_t_s is not None]
        lengths.append(max(times) - min(times))
    return float(np.median(lengths))

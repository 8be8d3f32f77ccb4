"""The text of the first page: the headline, the gains, in which block, and what to do."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hilserver.diagnosis.catalogue.vocabulary import cause_of
from hilserver.diagnosis.findings.explain import (
    COUNTS,
    QUANTITIES,
    explain_finding,
    number,
    remedy,
)
from hilserver.diagnosis.regression.gain import HORIZON_S
from hilserver.diagnosis.replay.judgeable import of_the_log
from hilserver.diagnosis.report.plain import plain
from hilserver.diagnosis.schema.evidence import CutRow
from hilserver.diagnosis.schema.findings import (
    ON_OTHER_LOGS,
    Finding,
    Findings,
    Gain,
    Interval,
    Overall,
    Parameter,
    Verdict,
)
from hilserver.measured.channels import POSITION

BADGES = {
    Verdict.NAMED: "Cause found",
    Verdict.NAMED_GROUP: "One of several causes",
    Verdict.EFFECTIVE: "Acts like",
    Verdict.STRUCTURE_NOT_IN_LIBRARY: "No known cause",
    Verdict.DRIFT: "Changes over time",
    Verdict.INSUFFICIENT_EXCITATION: "Too little motion to tell",
    Verdict.DATA_FAULT: "Data fault",
    Verdict.DIFFERS: "Differs",
    Verdict.NO_DIFFERENCE: "No difference",
}
LARGE = 1.5
"""Residual relative to noise alone from which a replay is clearly wrong; error before relative to
that after from which a model is clearly better."""
FAR_FROM_NOISE = 3.0
"""Error of the position relative to that of noise alone from which no simulation matches: where it
does, this is about 1."""
MOST_TIMES = 1000
"""Largest factor of an error that is shown; beyond it, the error before or after is almost zero."""
FREE_RUNS = ("position_m", "yaw_rad")
"""Quantities whose error is taken at the end of a free run; for the others it is the mean."""
BEHIND = (
    "The patch contains it, and the robot needs no change for that. Another cause may be behind it:"
    " 'hilserver plan' finds the manoeuvre that shows more."
)


def headline(findings: Findings) -> str:
    """Return the headline, one sentence: of the robot it says nothing that was not judged."""
    if findings.verdict in {Overall.DIFFERS, Overall.NO_DIFFERENCE}:
        return _compared(findings)
    named = [
        f for f in findings.findings if f.verdict is not Verdict.INSUFFICIENT_EXCITATION
    ]
    silent = [
        f for f in findings.findings if f.verdict is Verdict.INSUFFICIENT_EXCITATION
    ]
    faults = [f for f in named if f.verdict is Verdict.DATA_FAULT]
    of_log = f"{_count(faults)} fault{'s' * (len(faults) > 1)} in the recording"
    others, without = len(named) - len(faults), missing(findings)
    if (
        not others
        and not findings.smallest_detectable
        and (findings.not_judged or faults)
    ):
        begin = f"{of_log}, but n" if faults else "N"
        return f"{begin}othing about the robot could be judged{without}."
    if silent and not named:
        return plain(explain_finding(silent[0]))
    if not named and (left := _unexplained(findings)):
        return left
    if not named and without:
        return f"In what could be judged{without}, the simulation matches: nothing was found."
    if not named:
        return "The simulation matches these data: nothing was found."
    if len(named) == 1 and (others or not without):
        return plain(explain_finding(named[0]))
    if not others:
        judged = (
            f"what could be judged of the robot{without}" if without else "the robot"
        )
        return f"{of_log}, none in {judged}."
    what = "thing differs" if others == 1 else "things differ"
    text = f"{_count(named[:others])} {what} from the simulation"
    if faults:
        text += f", and the recording has {_count(faults).lower()} fault" + "s" * (
            len(faults) > 1
        )
    return f"{text}."


def _unexplained(findings: Findings) -> str:
    """Return that the position is further off than its noise explains; empty if it is not.

    An error that lasts can hide one of the simulation: the position alone shows how far both may
    drift apart in a free run.
    """
    error_m = findings.baseline.get("position_m", 0.0)
    own = [n for name, n in findings.noise.items() if name in POSITION]
    if not own:
        return ""

    # at both ends of a run, and what changes between them of an error that lasts
    variance = 0.0
    for noise in own:
        variance += 2.0 * (noise.white_sd**2 + (noise.step or 0.0) ** 2 / 12.0)
        if noise.ou_tau_s:
            changed = -math.expm1(-HORIZON_S / noise.ou_tau_s)
            variance += 2.0 * noise.ou_sd**2 * changed
    noise_m = math.sqrt(variance)
    if error_m <= FAR_FROM_NOISE * noise_m:
        return ""

    error, noise_alone = (number(m, "m", digits=2) for m in (error_m, noise_m))
    return (
        f"An error remains that no known cause explains: within {HORIZON_S:g} s the simulated"
        f" position goes {error} off, where the noise of the reference alone makes {noise_alone};"
        " check the signs and sides of the wheels, the dimensions, and the axes of the reference."
    )


def missing(findings: Findings) -> str:
    """Return in brackets what the recording lacks for some causes; empty if it lacks nothing."""
    reasons = ", ".join(
        n.reason for n in findings.not_judged if of_the_log(n.reason)
    ).split(", ")
    each = list(dict.fromkeys(reason.removesuffix(" in the log") for reason in reasons))
    # no wheel speed at all is also none on both sides
    said = [
        one for one in each if not any(one != other and one in other for other in each)
    ]
    return f" ({', '.join(said)})" if any(said) else ""


def _compared(findings: Findings) -> str:
    """Return the headline on two sets of recordings; faults of the recording are no difference."""
    differ = [f for f in findings.findings if f.verdict is Verdict.DIFFERS]
    if len(differ) == 1:
        return plain(explain_finding(differ[0]))
    if differ:
        return f"The two sets of recordings differ in {_count(differ).lower()} ways."
    silent = [
        f for f in findings.findings if f.verdict is Verdict.INSUFFICIENT_EXCITATION
    ]
    if silent:
        return plain(explain_finding(silent[0]))
    without = missing(findings)
    if not findings.smallest_detectable and findings.not_judged:
        return f"Nothing about the robot could be judged{without}."
    if without:
        return f"In what could be judged{without}, the two sets of recordings do not differ."
    return "The two sets of recordings do not differ."


def _count(items: Sequence[object]) -> str:
    return COUNTS[len(items)] if len(items) < len(COUNTS) else str(len(items))


@dataclass(frozen=True, slots=True)
class Gained:
    """The gain of one quantity, with its name and unit for reading."""

    name: str
    unit: str
    when: str  # ``after 5 s``; empty if the error does not grow along a run
    gain: Gain
    ceiling: float | None

    @property
    def is_clear(self) -> bool:
        """Whether the error is much smaller over the whole interval."""
        return (self.gain.ci95 or (self.gain.ratio,))[0] > LARGE


@dataclass(frozen=True, slots=True)
class RatioInWords:
    """A ratio of errors in words: that many times better, or worse, never 0.5 times better."""

    factor: float
    is_better: bool
    ci95: Interval | None

    @classmethod
    def of(cls, gain: Gain) -> "RatioInWords":
        """Return the change of an error, from before to after."""
        is_better, ends = not 0.0 < gain.ratio < 1.0, gain.ci95
        factor = gain.ratio if is_better else 1.0 / gain.ratio
        if factor > MOST_TIMES:
            ends = None
        elif not is_better and ends is not None:
            ends = 1.0 / ends[1], 1.0 / ends[0]
        return cls(factor, is_better, ends)

    @property
    def is_none(self) -> bool:
        """Whether the error is unchanged in two digits."""
        return number(self.factor, digits=2) == "1"

    @property
    def times(self) -> str:
        """How many times, in digits."""
        far = self.factor > MOST_TIMES
        return f"more than {MOST_TIMES}" if far else number(self.factor, digits=2)

    def __str__(self) -> str:
        """``3.2 times smaller``, ``1.1 times larger`` or ``unchanged``, with the interval."""
        text = f"{self.times} times {'smaller' if self.is_better else 'larger'}"
        text = "unchanged" if self.is_none else text
        if self.ci95 is None:
            return text
        low, high = (number(end, digits=2) for end in self.ci95)
        return f"{text}, 95\u00a0% {low} to {high}"


def gains(findings: Findings) -> list[Gained]:
    """Return the gain of every quantity with the patch: first position, last what sensors show."""
    order = list(QUANTITIES)
    return [
        Gained(*QUANTITIES[key], when(key, gain), gain, findings.ceiling.get(key))
        for key, gain in sorted(
            findings.total_gain.items(), key=lambda item: order.index(item[0])
        )
    ]


def when(key: str, gain: Gain) -> str:
    """Return after what time of a free run an error is taken; empty if it is a mean."""
    return f"after {number(gain.horizon_s, 's', digits=2)}" if key in FREE_RUNS else ""


def best(gained: Sequence[Gained]) -> Gained | None:
    """Return the gain with which the page begins: the first clear one, or else the largest."""
    better = [g for g in gained if g.gain.ratio > 1.0]
    largest = max(better, key=lambda g: g.gain.ratio, default=None)
    return next((g for g in gained if g.is_clear), largest)


def held_out(findings: Findings) -> str:
    """Return, in words, what the total gain was measured on."""
    other = any(notice.startswith(ON_OTHER_LOGS) for notice in findings.notices)
    return (
        "other logs"
        if other
        else "parts of the recording that were not used for the fit"
    )


def understated(findings: Findings) -> str:
    """Return why the total gain leaves out causes that were found; empty if it does not."""
    by = {0: "by neither", 1: "by one alone"}
    unshown = [
        f"{' or '.join(f.causes)} ({by[f.halves]})"
        for f in findings.findings
        if f.halves < 2
    ]
    if not unshown or held_out(findings) == "other logs":
        return ""
    return (
        "The gain of the extended model is measured on each half of the recording, with the"
        " causes that the other half shows on its own. Not shown by both halves:"
        f" {', '.join(unshown).replace('_', ' ')}."
        " The true gain is therefore larger; a longer recording would show how much."
    )


def is_unchanged(gain: Gain) -> bool:
    """Return whether an error is unchanged in two digits."""
    return number(gain.before, digits=2) == number(gain.after, digits=2)


def where(cuts: Sequence[CutRow]) -> str:
    """Return in which block the error arises, as one sentence; empty if none is large."""
    judged = {r.cut for r in cuts}
    large = {(r.cut, r.channel.startswith("wheel.")) for r in cuts if is_large(r)}
    named = []
    if ("duty", True) in large:
        named.append("in the motors, the gears or their load")
    elif ("setpoints", True) in large and "duty" in judged:
        named.append(
            "in the controller, in the transmission of the set-points or in the response of the"
            " motors"
        )
    elif ("setpoints", True) in large:
        named.append("in the drive")
    if ("speed", False) in large:
        named.append("in the kinematics or in the pose sensors")
    return f"The error arises {', and '.join(named)}." if named else ""


def is_large(row: CutRow) -> bool:
    """Return whether a residual clearly exceeds the sensors' noise."""
    return row.expected is not None and row.rms > LARGE * row.expected


@dataclass(frozen=True, slots=True)
class Advice:
    """Something to do."""

    label: str
    text: str = ""
    # what an unknown structure depends on: this is what to examine
    signals: tuple[str, ...] | None = None


def steps(findings: Findings) -> list[Advice]:
    """Return what to do, faults of the recording first."""
    items = []
    for item in sorted(
        findings.findings, key=lambda f: f.verdict is not Verdict.DATA_FAULT
    ):
        if item.separating_experiment:
            items.append(
                Advice(_label(item, "Find out which"), item.separating_experiment)
            )
        elif item.verdict is Verdict.STRUCTURE_NOT_IN_LIBRARY:
            items.append(
                Advice(_label(item, "Find the cause"), signals=tuple(item.regressors))
            )
        elif item.verdict is Verdict.EFFECTIVE:
            items.append(Advice(_label(item, "Find out what is behind it"), BEHIND))
        elif item.verdict is not Verdict.NO_DIFFERENCE:
            is_patched = findings.model_patch is not None
            items += [
                Advice(_label(item, cause), remedy(cause, patched=is_patched))
                for cause in item.causes[:1]
            ]
    return list(dict.fromkeys(items))


def _label(item: Finding, text: str) -> str:
    name = text.replace("_", " ").capitalize()
    return name if item.block == "data" else f"{name} ({item.block})"


@dataclass(frozen=True, slots=True)
class Belonging:
    """A fitted parameter and its owner: the machine, or one of the groups of logs."""

    name: str
    parameter: Parameter
    others: tuple[str, ...]  # causes that could replace it


def belonging(findings: Findings, *, differs: bool) -> list[Belonging]:
    """Return the fitted parameters that differ by group of logs, or those that do not."""
    if findings.groups is None:
        return []
    return [
        Belonging(name, p, item.causes[1:])
        for item in findings.findings
        if item.matters
        for name, p in item.parameters.items()
        if cause_of(name).name == item.causes[0]
        and (p.groups is not None) == differs
        and (p.groups is not None or p.ci95 is not None)
    ]


def shared_and_free(findings: Findings) -> list[str]:
    """Return in words what all groups of logs share, and what differs."""
    out = []
    if shared := belonging(findings, differs=False):
        names = ", ".join(
            f"{b.name} {number(b.parameter.value, b.parameter.unit)}" for b in shared
        )
        out.append(f"The same in all groups, so it belongs to the machine: {names}.")
    if free := belonging(findings, differs=True):
        said = []
        for b in free:
            unit = b.parameter.unit
            groups = (b.parameter.groups or {}).items()
            values = ", ".join(f"{name} {number(g.value, unit)}" for name, g in groups)
            said.append(f"{b.name} ({values})")
        out.append(
            f"Different by group, so it belongs to the floor or the load: {'; '.join(said)}."
        )
    return out

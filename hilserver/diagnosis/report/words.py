"""The first page: what is wrong, why, how much better the extension is, and what to do."""

from collections.abc import Sequence
from html import escape

from hilserver.diagnosis.evidence import CutRow
from hilserver.diagnosis.explain import QUANTITIES, explain_finding, number, remedy
from hilserver.diagnosis.findings import Finding, Findings, Gain, Overall, Parameter, Verdict
from hilserver.diagnosis.report import markup
from hilserver.diagnosis.report.svg import Scale
from hilserver.diagnosis.vocabulary import part_of

BADGES = {
    Verdict.NAMED: "Cause found",
    Verdict.NAMED_GROUP: "One of several causes",
    Verdict.STRUCTURE_NOT_IN_LIBRARY: "No known cause",
    Verdict.DRIFT: "Changes over time",
    Verdict.INSUFFICIENT_EXCITATION: "Too little motion to say",
    Verdict.DATA_FAULT: "Fault of the data",
    Verdict.DIFFERS: "Differs",
    Verdict.NO_DIFFERENCE: "No difference",
}
LARGE = 1.5
"""Residual, by what the noise alone would give, from which a replay is clearly wrong."""
COUNTS = ("No", "One", "Two", "Three", "Four", "Five", "Six", "Seven", "Eight", "Nine")
INTERVAL_WIDTH = 260.0


def headline(findings: Findings) -> str:
    """Return what the page says first, one sentence."""
    if not findings.findings and not findings.smallest_detectable and findings.not_judged:
        return "Nothing could be judged: these data lack channels, see what was not judged and why."
    silent = [f for f in findings.findings if f.verdict is Verdict.INSUFFICIENT_EXCITATION]
    if silent and findings.verdict in {Overall.NOTHING_FOUND, Overall.NO_DIFFERENCE}:
        return explain_finding(silent[0])
    if findings.verdict is Overall.NOTHING_FOUND:
        return "The simulation fits these data: nothing was found."
    if findings.verdict is Overall.NO_DIFFERENCE:
        return "The two sets of recordings do not differ."
    told = [f for f in findings.findings if f.verdict is not Verdict.INSUFFICIENT_EXCITATION]
    if len(told) == 1:
        return explain_finding(told[0])
    if findings.verdict is Overall.DIFFERS:
        return f"The two sets of recordings differ in {_count(told).lower()} things."
    faults = [f for f in told if f.verdict is Verdict.DATA_FAULT]
    if len(faults) == len(told):
        return f"{_count(faults)} faults of the recording, none of the robot."
    others = len(told) - len(faults)
    what = "thing is" if others == 1 else "things are"
    text = f"{_count(told[:others])} {what} not as the simulation has it"
    if faults:
        text += f", and the recording has {_count(faults).lower()} fault" + "s" * (len(faults) > 1)
    return f"{text}."


def _count(items: Sequence[object]) -> str:
    return COUNTS[len(items)] if len(items) < len(COUNTS) else str(len(items))


def lede(findings: Findings) -> str:
    """Return HTML: how much better the extended model is, or what was looked for."""
    gained = {key: gain for key, gain in findings.total_gain.items() if gain.ratio > 1}
    if not gained:
        if findings.verdict is Overall.NOTHING_FOUND:
            n = len(findings.smallest_detectable)
            sizes = (
                f" How large each of {n} effects would have had to be to be seen stands below."
                if n
                else ""
            )
            return f"What remains between measurement and simulation is the sensors' noise.{sizes}"
        return ""
    key, gain = max(gained.items(), key=lambda item: item[1].ratio)
    name, unit = QUANTITIES.get(key, (key, "1"))
    return (
        f"With the extended model the error in <strong>{escape(name)}</strong> after"
        f" {number(gain.horizon_s)}&nbsp;s falls from {escape(number(gain.before, unit))} to"
        f" {escape(number(gain.after, unit))}: <strong>{_times(gain)}</strong>{_sure(gain)}, on"
        " parts of the recording that took no part in the fit."
    )


def _times(gain: Gain) -> str:
    return f"{number(gain.ratio, digits=2)} times smaller"


def _sure(gain: Gain) -> str:
    if gain.ci95 is None:
        return ""
    low, high = (number(v, digits=2) for v in gain.ci95)
    return f" (95&nbsp;% between {low} and {high})"


def tiles(findings: Findings) -> str:
    """Return the gain of every quantity as HTML."""
    items, unchanged = [], []
    for key, gain in sorted(findings.total_gain.items(), key=lambda item: -item[1].ratio):
        if is_unchanged(gain):
            unchanged.append(QUANTITIES.get(key, (key, "1"))[0])
            continue
        name, unit = QUANTITIES.get(key, (key, "1"))
        largest = max(gain.before, gain.after) or 1.0
        ceiling = findings.ceiling.get(key)
        reach = (
            ""
            if ceiling is None
            else f'<div class="what">a flexible regression reaches {number(ceiling, digits=2)}'
            " times</div>"
        )
        items.append(
            f'<li><div class="what">{escape(name.capitalize())} after {number(gain.horizon_s)}'
            f'&nbsp;s</div><div class="ratio">{number(gain.ratio, digits=2)}&times;'
            f" <small>better{_range(gain)}</small></div>"
            f'<div class="pair"><span>before</span>'
            f"{markup.bar(gain.before / largest, 'simulated')}"
            f"<span>{escape(number(gain.before, unit, digits=2))}</span><span>after</span>"
            f"{markup.bar(gain.after / largest, 'extended')}"
            f"<span>{escape(number(gain.after, unit, digits=2))}</span></div>{reach}</li>"
        )
    shown = f'<ul class="tiles">{"".join(items)}</ul>' if items else ""
    if unchanged:
        shown += f'<p class="unchanged">Not changed: {escape(", ".join(unchanged))}.</p>'
    return shown


def is_unchanged(gain: Gain) -> bool:
    """Return whether an error is, in two digits, what it was."""
    return number(gain.before, digits=2) == number(gain.after, digits=2)


def _range(gain: Gain) -> str:
    if gain.ci95 is None:
        return ""
    low, high = (number(v, digits=2) for v in gain.ci95)
    return f", {low} to {high}"


def finding(item: Finding) -> str:
    """Return one finding as HTML."""
    names = " or ".join(c.replace("_", " ") for c in item.causes)
    named = f" &ensp;{', '.join(markup.code(c) for c in item.causes)}" if item.causes else ""
    parts = [
        f'<span class="badge {item.verdict}">{BADGES[item.verdict]}</span>{named}',
        f'<p class="title">{escape(explain_finding(item))}</p>',
        _values(item),
    ]
    if item.p_adjusted is not None:
        chance = number(max(item.p_adjusted, 1e-4), digits=2)
        least = "at most " if item.p_adjusted < 1e-4 else ""
        parts.append(
            markup.paragraph(
                f"Why this: the deviation follows {names or 'a regressor'} in a way that chance"
                f" gives with a probability of {least}{chance}, counting every cause that was"
                " looked for."
            )
        )
    if item.regressors:
        on = ", ".join(markup.code(r) for r in item.regressors)
        parts.append(f'<p><span class="label">Depends on</span> {on}</p>')
    if gained := _gained(item):
        parts.append(markup.paragraph(gained))
    return f'<li class="finding">{"".join(parts)}</li>'


def _gained(item: Finding) -> str:
    told = []
    for key, gain in item.gain.items():
        name, unit = QUANTITIES.get(key, (key, "1"))
        told.append(
            f"{name} {number(gain.before, unit, digits=2)} to"
            f" {number(gain.after, unit, digits=2)} ({number(gain.ratio, digits=2)} times smaller)"
        )
    return f"What it gains alone: {'; '.join(told)}." if told else ""


def _values(item: Finding) -> str:
    rows = []
    for name, parameter in item.parameters.items():
        interval = ""
        if parameter.ci95 is not None:
            low, high = (number(v) for v in parameter.ci95)
            interval = f"95&nbsp;% between {low} and {high}"
        rows.append(
            f"<span>{markup.code(name)} = <b>{escape(number(parameter.value, parameter.unit))}</b>"
            f'</span><span class="interval">{interval}</span>{_interval(name, parameter)}'
        )
    return f'<div class="values">{"".join(rows)}</div>' if rows else ""


def _interval(name: str, parameter: Parameter) -> str:
    """Draw value and interval beside the null."""
    try:
        null = part_of(name).null
    except KeyError:
        null = None
    if parameter.ci95 is None or null is None:
        return "<span></span>"
    low, high = parameter.ci95
    left, right = min(low, null), max(high, null)
    margin = 0.08 * ((right - left) or 1.0)
    to_x = Scale(left - margin, right + margin, 0, INTERVAL_WIDTH)
    a, b, at, zero = (float(to_x(v)) for v in (low, high, parameter.value, null))
    text = escape(f"{name}: {number(low)} to {number(high)}; without the effect {number(null)}")
    return (
        f'<svg viewBox="0 0 {INTERVAL_WIDTH:g} 24" role="img" aria-label="{text}">'
        f'<path class="grid" d="M0 12H{INTERVAL_WIDTH:g}"/>'
        f'<path class="null" d="M{zero:.1f} 4V20"/>'
        f'<path class="whisker" d="M{a:.1f} 12H{b:.1f}"/>'
        f'<circle class="dot" cx="{at:.1f}" cy="12" r="5"/><title>{text}</title></svg>'
    )


def where(cuts: Sequence[CutRow]) -> str:
    """Return in which block the error arises, as one sentence; nothing where none is large."""
    judged = {r.cut for r in cuts}
    large = {(r.cut, r.channel.startswith("wheel.")) for r in cuts if is_large(r)}
    told = []
    if ("duty", True) in large:
        told.append("in the motors, the gears or their load")
    elif ("setpoints", True) in large and "duty" in judged:
        told.append(
            "in the controller, on the way of the set-points or in how fast the motors follow"
        )
    elif ("setpoints", True) in large:
        told.append("in the drive")
    if ("speed", False) in large:
        told.append("in the kinematics or the sensors of the pose")
    return f"The error arises {', and '.join(told)}." if told else ""


def is_large(row: CutRow) -> bool:
    """Return whether a residual is clearly more than the sensors' noise."""
    return row.expected is not None and row.rms > LARGE * row.expected


def steps(findings: Findings) -> str:
    """Return what to do, as an ordered list in HTML."""
    items: list[str] = []
    for item in sorted(findings.findings, key=lambda f: f.verdict is not Verdict.DATA_FAULT):
        if item.separating_experiment:
            items.append(f"{_label(item, 'Find out which')}{escape(item.separating_experiment)}")
        elif item.verdict is Verdict.STRUCTURE_NOT_IN_LIBRARY:
            items.append(
                f"{_label(item, 'Look for the rest')}Look at what changes with"
                f" {', '.join(map(markup.code, item.regressors)) or 'time and place'}; no patch can"
                " be made of it."
            )
        elif item.verdict is not Verdict.NO_DIFFERENCE:
            items += [f"{_label(item, cause)}{escape(remedy(cause))}" for cause in item.causes[:1]]
    if findings.model_patch:
        items.append(
            '<span class="label">Run the extended model.</span> It is the same plant with these'
            " terms switched on; without the option the old outputs are back, bit for bit."
            f"<pre>hilserver run --patch {escape(findings.model_patch)}</pre>"
        )
    unique = dict.fromkeys(items)
    return f'<ol class="steps">{"".join(f"<li>{i}</li>" for i in unique)}</ol>' if items else ""


def _label(item: Finding, text: str) -> str:
    name = text.replace("_", " ").capitalize()
    where = f" ({item.block})" if item.block != "data" else ""
    return f'<span class="label">{escape(name)}{where}.</span> '

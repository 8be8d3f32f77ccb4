"""Findings in words that a technician understands; the sentences are in `sentences.yaml`."""

import re
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.resources import files
from typing import Any, Final

import yaml

from hilserver.diagnosis.catalogue.vocabulary import CAUSES, cause_of, known_part
from hilserver.diagnosis.schema.findings import Finding, Parameter, Verdict
from hilserver.plant.layout import WHEEL_WORDS, WHEELS

MINUS: Final = "\N{MINUS SIGN}"
QUANTITIES: Final[Mapping[str, tuple[str, str]]] = {
    "position_m": ("position", "m"),
    "yaw_rad": ("heading", "rad"),
    "speed_rpm": ("wheel speed", "rpm"),
    "duty_pct": ("duty", "%"),
    "gyro_z_rad_s": ("turn rate", "rad/s"),
}
"""Keys of a gain: their names in words, and their unit."""

COUNTS: Final = (
    "No", "One", "Two", "Three", "Four", "Five", "Six", "Seven", "Eight", "Nine"
)  # fmt: skip

NO_EDGE_M: Final = 1e3
"""Edges of a part of the floor from here on are those of no floor."""

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_CHOICE = re.compile(r"\{([^{}|]*)\|([^{}|]*)\}")
_FIELD = re.compile(r"\{(?:(of):)?(\w+)\}")


@cache
def _read() -> dict[str, Any]:
    folder = files("hilserver.diagnosis.findings")
    text = folder.joinpath("sentences.yaml").read_text(encoding="utf-8")
    return dict(yaml.safe_load(text))


def sentences() -> Mapping[str, Mapping[str, str]]:
    """Return for every cause what it ``says``, a template, and its ``remedy``."""
    return dict(_read()["causes"])


@cache
def experiments() -> Mapping[frozenset[str], str]:
    """Return the experiments that separate causes, by the causes."""
    return {frozenset(e["causes"]): e["text"] for e in _read()["experiments"]}


def number(value: float, unit: str = "1", *, digits: int = 3) -> str:
    """Return a value for reading: rounded to `digits`, with a true minus and its unit."""
    text = f"{value:.{digits}g}"
    if "e" in text:
        mantissa, exponent = text.split("e")
        small = f"{mantissa}·{power_of_ten(int(exponent))}"
        text = small if abs(value) < 1e-3 else f"{value:.0f}"
    text = text.replace("-", MINUS)
    return text if unit == "1" else f"{text}\u00a0{unit}"


def power_of_ten(exponent: int) -> str:
    """Return ten to a power with a raised exponent."""
    return "10" + str(exponent).translate(_RAISED)


def explain(
    causes: Iterable[str], parameters: Mapping[str, Parameter], acting: int = 1
) -> str:
    """Return one sentence that says what these causes are; for several, what each would be.

    Parameters
    ----------
    causes : iterable of str
        Names of the vocabulary.
    parameters : mapping of str to Parameter
        By ``cause``, ``cause.part`` or ``cause.signal``; those of other causes are ignored.
    acting : int
        How many of several causes act.
    """
    said = [_say(name, parameters) for name in causes]
    if len(said) == 1:
        return said[0]
    inner = "; or: ".join(_lower(text.rstrip(".")) for text in said)
    sizes = "" if acting == 1 else "; how large one is depends on the others"
    many = COUNTS[acting]
    return f"{many} of these, which the data cannot separate{sizes}: {inner}."


def explain_finding(finding: Finding) -> str:
    """Return the finding's own explanation, or one made from its causes and parameters."""
    if finding.explanation:
        return finding.explanation
    if finding.verdict is Verdict.STRUCTURE_NOT_IN_LIBRARY:
        on = ", ".join(finding.regressors) or "nothing that was measured"
        most = "".join(f", and is largest in {signal}" for signal in finding.parameters)
        return (
            f"An error remains that no known cause explains; it depends on {on}{most}."
        )
    if not finding.causes:
        return (
            "The simulation deviates from the measurement, but no cause can be named."
        )
    text = explain(finding.causes, finding.parameters)
    if finding.verdict is Verdict.EFFECTIVE:
        alike = _lower(text.rstrip("."))
        return f"It acts as if this were so: {alike}; what is behind it, these data do not tell."
    if finding.verdict is Verdict.DRIFT:
        return f"Not constant over the recording: {_lower(text)}"
    return text


def of_two_wheels(finding: Finding) -> Finding:
    """Return a finding of a robot with one wheel per side, without front and rear."""
    text = finding.explanation
    for side in ("left", "right"):
        text = text.replace(f"front {side} or rear {side}", side)
    return finding.model_copy(update={"explanation": text})


def remedy(cause: str, *, patched: bool) -> str:
    """Return what to do about a cause, with a patch or without one."""
    said = sentences()[cause_of(cause).name]
    return (
        f"{said['remedy']} {said['patch']}"
        if patched and "patch" in said
        else said["remedy"]
    )


def separating_experiment(causes: Iterable[str]) -> str:
    """Return what would separate the causes of a group: the fewest sentences that name them all.

    A pair without its own sentence gets what makes the first cause visible.
    """
    left = {cause_of(name).name for name in causes}
    group, texts = frozenset(left), []
    known = [(key, text) for key, text in experiments().items() if key <= group]
    while left:
        best = max(known, key=lambda entry: len(entry[0] & left), default=None)
        if best is None or not best[0] & left:
            break
        texts.append(best[1])
        left -= best[0]
    if left and len(group) > 1 and (not texts or len(left) > 1):
        names = ", ".join(sorted(left))
        texts.append(
            f"For {names}: 'hilserver plan' finds the manoeuvre and the channels that separate"
            " them."
        )
    return " ".join(texts)


def _lower(text: str) -> str:
    return text[:1].lower() + text[1:]


def _say(cause: str, parameters: Mapping[str, Parameter]) -> str:
    """Return the sentence of a cause with its parameters filled in."""
    own = {
        n: p for n, p in parameters.items() if n == cause or n.startswith(f"{cause}.")
    }
    by_part = {
        part.name: p for n, p in own.items() if (part := known_part(n)) is not None
    }
    parts = CAUSES[cause].parts
    known = [by_part[part.name] for part in parts if part.name in by_part]
    main = next(iter((*known, *own.values())), None)

    def chosen(match: re.Match[str]) -> str:
        if main is None:
            return f"{match[1]} or {match[2]}"
        return match[1] if main.value >= (parts[0].null or 0.0) else match[2]

    def filled(match: re.Match[str]) -> str:
        name = match[2]
        if match[1]:
            return _value(name, own.get(f"{cause}.{name}"))
        if name == "where":
            return (
                ", ".join(n.removeprefix(f"{cause}.") for n in own if n != cause)
                or "a channel"
            )
        if name == "region":
            return _region(own)
        if name == "values":
            return _all_of(own) or "some"
        if main is None:
            return "somewhat" if name == "percent" else "some"
        size = abs(main.value)
        shown = {"value": (main.value, main.unit), "size": (size, main.unit),
                 "percent": (100 * size, "%"), "number": (size, "1")}  # fmt: skip
        return number(*shown[name])

    return _FIELD.sub(filled, _CHOICE.sub(chosen, sentences()[cause]["says"]))


def _all_of(own: Mapping[str, Parameter]) -> str:
    """Return all parameters of a cause except those of its shape."""
    return ", ".join(
        f"{name.partition('.')[2] or name} {number(p.value, p.unit)}"
        for name, p in own.items()
        if (part := known_part(name)) is None or not part.shape
    )


def _region(own: Mapping[str, Parameter]) -> str:
    """Return a part of the floor in words; an edge beyond any floor is none."""
    edges = {
        name.rpartition(".")[2]: number(p.value, p.unit)
        for name, p in own.items()
        if p.unit == "m" and abs(p.value) < NO_EDGE_M
    }
    inside = []
    for axis in "xy":
        low, high = edges.get(f"{axis}_min"), edges.get(f"{axis}_max")
        if low and high:
            inside.append(f"{axis} is between {low} and {high}")
        elif low or high:
            inside.append(
                f"{axis} is above {low}" if low else f"{axis} is below {high}"
            )
    return f"Where {' and '.join(inside)}" if inside else "Everywhere"


def _value(part: str, parameter: Parameter | None) -> str:
    """Return one parameter; for a wheel its name, or the names of all that it may be."""
    if parameter is None:
        return "?"
    if part == "wheel":
        possible = dict.fromkeys(map(int, parameter.ci95 or (parameter.value,)))
        return " or ".join(WHEEL_WORDS[WHEELS[wheel]] for wheel in possible)
    return number(parameter.value, parameter.unit)

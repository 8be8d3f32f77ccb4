"""Hidden causes, drawn: which, how large, with which sign, beside which fault of the log.

The seeds come from a secret: a hash of the commit, or what a campaign is given. The diagnosis gets
files with neutral names and its own seed; nothing that it is handed leads back to a secret.
"""

import hashlib
import math
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from hilserver_injector import CAUSES, Recipe, Table
from hilserver_injector.cases import Answer, faults
from hilserver_injector.faults import apply
from hilserver_injector.make import make

from tests.diagnosis.blind import second

FIRST, SECOND = MAKERS = ("first", "second")
SHORT_S = {"drive": 75.0, "bench": 8.0, "mecanum": 45.0}
LENGTH_S = {"drive": 120.0, "bench": 15.0, "mecanum": 90.0, "launches": 120.0}
SHOWN_BY = {"roller_slip": "mecanum", "acceleration_slip": "launches"}
"""Drives that show what neither the mixed drive nor the bench does."""

TIMES_SMALLEST, TIMES_REFERENCE = 2.0, 4.0
MOST = {
    "saturation_limit": 1.55, "control_period": 1.3, "controller_gains": 2.6, "battery_sag": 2.4,
    "surface_change": 2.3, "time_constant": 3.0, "longitudinal_slip": 3.3, "nav_outliers": 3.0,
    "friction_anisotropy": 2.6, "backlash": 2.0,
}  # fmt: skip
"""Largest size in reference sizes where four would be no machine: a gain below zero, an unstable
loop, a limit of the duty below what the wheels need to turn."""
UNSTATED = 0.5
"""Smallest size in reference sizes of a cause for which a diagnosis states none."""
TOGETHER = {
    "icr_offset": "nav_lever_arm",
    "wheel_misalignment": "nav_frame_yaw",
    "nav_frame_yaw": "wheel_misalignment",
    "nav_scale": "traction_slip",
    "traction_slip": "nav_scale",
    "friction_anisotropy": "rotation_gain",
}
"""By cause: the twin that one log cannot tell from it, so that they have to be one group."""
STATED_AS = {"traction_slip": "nav_scale"}
FAR_M = 100.0
"""An edge beyond is none."""
BOTH_SIGNS = frozenset({"controller_gains"})


def commit():
    """The secret of this commit: the hash of its package, so that documents do not redraw.

    The same for all trees that are no checkout.
    """
    words = ["git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD:hilserver"]
    try:
        run = subprocess.run(words, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "no checkout"
    return run.stdout.strip()


def seed_of(*words):
    """A seed of 63 bits that only who knows all words can tell."""
    text = "/".join(map(str, words))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8]) >> 1


@dataclass(frozen=True)
class Drive:
    """What one machine is asked to do, by one of the generators; its logs differ in their noise."""

    maker: str
    kind: str  # of LENGTH_S
    seed: int
    length_s: float

    @property
    def machine(self):
        """The wheels that a diagnosis has to know of."""
        return "mecanum" if self.kind == "mecanum" else "skid"

    def can_hide(self, causes):
        """Whether the generator has these causes, or effects outside the library."""
        return self.maker == FIRST or second.can_hide(causes)

    def log(self, causes: Mapping[str, float], seed: int) -> Table:
        """Drive it once, with something hidden."""
        if self.maker == SECOND:
            return second.make(self.kind, self.length_s, self.seed, seed, causes)
        how = {"manoeuvre_seed": self.seed, "duration_s": self.length_s}
        recipe = Recipe(seed=seed, causes=causes, **how)
        if self.kind == "bench":
            recipe = replace(recipe, kind="bench")
        elif self.kind == "mecanum":
            recipe = replace(recipe, drive="mecanum", manoeuvre="omni")
        elif self.kind != "drive":
            recipe = replace(recipe, manoeuvre=self.kind)
        return make(recipe)[0]


@dataclass(frozen=True)
class Hidden:
    """A log with what is hidden in it."""

    drive: Drive
    name: str  # of its causes, with + between two
    causes: Mapping[str, float]
    seed: int
    answer: Answer
    faults: Mapping[str, object] = field(default_factory=dict)

    def log(self):
        """The log alone."""
        table = self.drive.log(self.causes, self.seed)
        apply(Recipe(seed=self.seed, faults=self.faults), table, {})
        return table


@dataclass(frozen=True)
class Shown:
    """What a drive shows: known from a log of it with nothing hidden."""

    # that a diagnosis states: the smallest detectable one of each cause
    sizes: Mapping[str, float]
    middle_m: tuple[float, float]  # medians of x and y; NaN on the bench


def middle_m(table):
    """The medians of a log's positions: half of the drive lies on either side."""
    return tuple(
        float(np.nanmedian(table.columns[name])) if name in table.columns else math.nan
        for name in ("nav.x_m", "nav.y_m")
    )


def null(drive, seed):
    """Nothing hidden."""
    return Hidden(drive, "nothing", {}, seed, Answer(verdict="nothing_found"))


def kind_of(cause):
    """The drive that shows a cause."""
    return SHOWN_BY.get(cause, CAUSES[cause].kind)


def size(cause, shown, rng):
    """The parameters of a cause, log-uniform from twice what would just show to a large size.

    Returns
    -------
    dict of str to float, or None
        None: this drive shows it only where it is larger than any machine has it.
    """
    one = CAUSES[cause]
    smallest = shown.sizes.get(STATED_AS.get(cause, cause))
    if smallest is None:
        least = UNSTATED
    elif cause == "setpoint_rate_limit":  # the smaller the limit the larger the effect
        least = TIMES_SMALLEST * one.size / smallest
    else:
        least = TIMES_SMALLEST * smallest / abs(one.size - one.base)
    most = MOST.get(cause, TIMES_REFERENCE)
    if least >= most:
        return None
    values = one.draw(rng, math.exp(rng.uniform(math.log(least), math.log(most))))
    if (
        cause == "surface_change"
    ):  # a robot that never crosses the edge has another constant
        for axis, middle in zip("xy", shown.middle_m, strict=True):
            edges = [f"{cause}.{axis}_min", f"{cause}.{axis}_max"]
            values |= {edge: middle for edge in edges if abs(values[edge]) < FAR_M}
    if cause in BOTH_SIGNS and rng.random() < 0.5:
        values = {name: -value for name, value in values.items()}
    return values


def hidden(cause, drive, shown, seed, fault=False):
    """A log with one cause, perhaps beside a fault; None where the drive cannot show it."""
    rng = np.random.default_rng(seed)
    values = size(cause, shown, rng)
    if values is None:
        return None
    scored = {CAUSES[cause].parameter: values[CAUSES[cause].parameter]}
    if cause in {
        "nav_lever_arm",
        "floor_slope",
    }:  # of a small part of them one can say little
        largest = max(map(abs, values.values()))
        scored = {
            name: value for name, value in values.items() if abs(value) > 0.5 * largest
        }
    names = frozenset({cause})
    twin = TOGETHER.get(cause)
    verdict = "named" if twin is None else "named_group"
    together = frozenset() if twin is None else names | {twin}
    answer = Answer(verdict=verdict, causes=(names,), together=together, values=scored)
    made = Hidden(drive, cause, values, seed, answer)
    return with_fault(made, rng) if fault else made


OF_WHEELS = ("sign of a wheel", "rpm as rad/s")
OF_MOTION = (
    "swapped sides",
    "sign of the gyro",
    "sign of the heading",
    "deg/s as rad/s",
)
"""Faults that leave everything in the log, so that a cause shows as well as without them. On the
bench both sides may do the same, and nobody sees that they are swapped."""


def with_fault(made, rng):
    """The same log with a fault in it, which has to be named as well."""
    names = OF_WHEELS if made.drive.kind == "bench" else OF_WHEELS + OF_MOTION
    wanted = names[int(rng.integers(len(names)))]
    (case,) = (case for case in faults(made.seed) if case.name == wanted)
    hidden = (*made.answer.causes, *case.answer.causes)
    both = replace(made.answer, causes=hidden, verdict="named")
    return replace(made, faults=case.recipe.faults, answer=both)


def pair(one, other):
    """A log with the causes of two logs of the same drive."""
    answer = replace(
        one.answer,
        causes=one.answer.causes + other.answer.causes,
        together=one.answer.together | other.answer.together,
        values={**one.answer.values, **other.answer.values},
        verdict="named",
    )
    causes = {**one.causes, **other.causes}
    return replace(one, name=f"{one.name}+{other.name}", causes=causes, answer=answer)

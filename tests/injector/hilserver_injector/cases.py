"""The campaign's cases: a recipe, and what a right answer to its log is."""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from hilserver_injector.causes import CAUSES, REQUIRED, TWINS, nothing, single
from hilserver_injector.ordinary import ON_A_STAND, held, ordinary
from hilserver_injector.recipe import Recipe, Recorder


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What must come out.

    Attributes
    ----------
    verdict : str
        Of the finding: named, named_group, structure_not_in_library, drift, data_fault; or
        nothing_found.
    causes : tuple of frozenset of str
        For each thing that is hidden, the names of which the finding must hold one.
    together : frozenset of str
        Names that a group must hold besides, because this log cannot tell them apart.
    regressors : frozenset of str
        One of these must be the first that the finding names.
    values : mapping of str to float
        Parameters whose value is scored.
    """

    verdict: str = "named"
    causes: tuple[frozenset[str], ...] = ()
    together: frozenset[str] = frozenset()
    regressors: frozenset[str] = frozenset()
    values: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Case:
    """One log of the campaign."""

    group: str
    name: str
    recipe: Recipe
    answer: Answer

    @property
    def key(self) -> str:
        """Its name among all cases of a campaign."""
        return f"{self.group}/{self.name}/{self.recipe.seed}"


def _only(*names: str) -> tuple[frozenset[str], ...]:
    return tuple(frozenset({name}) for name in names)


def null(seed: int) -> Iterator[Case]:
    """Nothing hidden: two logs of driving and one of the bench per seed."""
    answer = Answer(verdict="nothing_found")
    yield Case("null", "drive", nothing("drive", 2 * seed), answer)
    yield Case("null", "drive", nothing("drive", 2 * seed + 1), answer)
    yield Case("null", "bench", nothing("bench", seed), answer)


def singles(
    seed: int, scale: float = 1.0, names: tuple[str, ...] = REQUIRED
) -> Iterator[Case]:
    """Every cause alone."""
    for name in names:
        recipe = single(name, seed, scale)
        values = {CAUSES[name].parameter: recipe.causes[CAUSES[name].parameter]}
        if name in {"nav_lever_arm", "floor_slope"}:
            values = {
                key: value for key, value in recipe.causes.items() if abs(value) > 0.01
            }
        yield Case("single", name, recipe, Answer(causes=_only(name), values=values))


def pairs(seed: int) -> Iterator[Case]:
    """Two effects at once, of the same kind of log and no twins; eight pairs per seed."""
    rng = np.random.default_rng([seed, 2])
    able = [
        pair
        for pair in itertools.combinations(REQUIRED, 2)
        if CAUSES[pair[0]].kind == CAUSES[pair[1]].kind and frozenset(pair) not in TWINS
    ]
    for pick in rng.choice(len(able), 8, replace=False):
        a, b = able[pick]
        first, second = single(a, seed), single(b, seed)
        recipe = replace(first, causes={**first.causes, **second.causes})
        values = {
            CAUSES[name].parameter: recipe.causes[CAUSES[name].parameter]
            for name in (a, b)
        }
        yield Case(
            "pair", f"{a}+{b}", recipe, Answer(causes=_only(a, b), values=values)
        )


def _twin(
    seed: int, name: str, causes: Mapping[str, float], together: set[str], **how: object
) -> Case:
    recipe = replace(Recipe(seed=seed, causes=causes), **how)  # type: ignore[arg-type]
    truth = next(iter(causes)).partition(".")[0]
    answer = Answer(
        verdict="named_group",
        causes=_only(truth),
        together=frozenset(together | {truth}),
    )
    return Case("twin", name, recipe, answer)


def twins(seed: int) -> Iterator[Case]:
    """What the log cannot tell apart must come out as a group that holds the truth."""
    sign = float(np.random.default_rng([seed, 3]).choice([-1.0, 1.0]))
    on_spot = Recorder(channels=("setpoint", "speed", "duty", "gyro"))
    no_duty = Recorder(rate_hz=500.0, row_jitter_s=0.0, channels=("setpoint", "speed"))
    yield _twin(seed, "icr_offset", {"icr_offset": 0.06 * sign}, {"nav_lever_arm"})
    yield _twin(seed, "nav_lever_arm", {"nav_lever_arm.x": 0.08 * sign}, {"icr_offset"})
    yield _twin(
        seed, "misalignment", {"wheel_misalignment": 0.03 * sign}, {"nav_frame_yaw"}
    )
    yield _twin(
        seed, "frame_yaw", {"nav_frame_yaw": 0.05 * sign}, {"wheel_misalignment"}
    )
    for name in ("rotation_gain", "gyro_scale"):
        others = {"rotation_gain", "gyro_scale", "wheel_radius"}
        how: dict[str, object] = {
            "manoeuvre": "spins",
            "recorder": on_spot,
            "duration_s": 180.0,
        }
        yield _twin(seed, f"spins {name}", {name: 0.05 * sign}, others, **how)
    bench = {"kind": "bench", "recorder": no_duty, "manoeuvre": "flat_out"}
    yield _twin(seed, "gain", {"process_gain": -0.3}, {"saturation_limit"}, **bench)
    yield _twin(seed, "limit", {"saturation_limit": 70.0}, {"process_gain"}, **bench)
    one_way = {"kind": "bench", "manoeuvre": "one_way"}
    yield _twin(seed, "friction", {"coulomb_friction": 1.5}, {"dead_zone"}, **one_way)
    yield _twin(seed, "dead_zone", {"dead_zone": 2.0}, {"coulomb_friction"}, **one_way)


def outside(seed: int) -> Iterator[Case]:
    """Effects that no cause of the vocabulary describes."""
    rng = np.random.default_rng([seed, 4])
    sign, phase = float(rng.choice([-1.0, 1.0])), float(rng.uniform(-math.pi, math.pi))
    source, target = (int(w) for w in rng.choice(4, 2, replace=False))
    wheels = ("fl", "rl", "fr", "rr")
    # both wheels of a side do the same, unless one of them is the wheel that suffers
    alike = {source, source ^ 1} - {target}
    of_source = {
        f"wheel.{wheels[w]}.{what}"
        for w in alike
        for what in ("duty_pct", "speed_rpm", "setpoint_rpm")
    }
    of_turning = {
        "velocity.angular_rad_s",
        "imu.gyro_z_rad_s",
        "velocity.linear_m_s",
        "history",
    }
    sent = {f"wheel.{wheel}.setpoint_rpm" for wheel in wheels}
    heading = {"nav.yaw_rad", "pose.yaw_rad", "imu.yaw_rad"}
    period = float(rng.uniform(6.0, 25.0))
    hidden: dict[str, tuple[dict[str, float], set[str]]] = {
        "cable_drag": (
            {
                ("cable_drag.turn", "cable_drag.speed")[seed % 2]: 0.2 * sign,
                "cable_drag.phase": phase,
            },
            heading,
        ),
        "cross_talk": (
            {
                "cross_talk.share": 0.12 * sign,
                "cross_talk.from": float(source),
                "cross_talk.to": float(target),
            },
            of_source,
        ),
        "lost_setpoints": (
            {"lost_setpoints.rate": 0.15, "lost_setpoints.length": 0.4},
            sent | {"t_s", "history"},
        ),
        "periodic": (
            {"periodic.turn": 0.05, "periodic.period": period, "periodic.phase": phase},
            {"t_s"},
        ),
        "hysteresis": ({"hysteresis": 0.12 * sign}, of_turning),
    }
    for name, (causes, regressors) in hidden.items():
        answer = Answer(
            verdict="structure_not_in_library", regressors=frozenset(regressors)
        )
        yield Case("outside", name, Recipe(seed=seed, causes=causes), answer)


def faults(seed: int) -> Iterator[Case]:
    """Faults of the log over a sound machine."""
    rng = np.random.default_rng([seed, 5])
    offset, drift = float(rng.uniform(0.15, 0.4) * rng.choice([-1, 1])), 4e-4
    spoilt: tuple[tuple[str, str, Mapping[str, object]], ...] = (
        ("sign_flip", "sign of the gyro", {"sign_flip": "imu.gyro_z"}),
        ("sign_flip", "sign of the heading", {"sign_flip": "nav.yaw"}),
        ("sign_flip", "sign of a wheel", {"sign_flip": "wheel.rr.speed"}),
        ("swapped_sides", "swapped sides", {"swapped_sides": "speed_rpm"}),
        ("unit_error", "rpm as rad/s", {"unit_error": ("speed_rpm", math.pi / 30.0)}),
        (
            "unit_error",
            "deg/s as rad/s",
            {"unit_error": ("imu.gyro_z", 180.0 / math.pi)},
        ),
        ("held_samples", "held speed", {"held_samples": ("speed_rpm", 4.0)}),
        ("held_samples", "held gyro", {"held_samples": ("imu.gyro_z", 10.0)}),
        (
            "interpolated_setpoint",
            "interpolated set-point",
            {"interpolated_setpoint": 10.0},
        ),
        (
            "setpoint_as_measurement",
            "set-point as speed",
            {"setpoint_as_measurement": True},
        ),
        ("dropouts", "dropouts", {"dropouts": ("speed_rpm", 0.05)}),
        ("clock_offset", "clock of the tag", {"clock": ("nav.", offset, 0.0)}),
        ("clock_drift", "drifting clock of the tag", {"clock": ("nav.", 0.0, drift)}),
    )
    for cause, name, what in spoilt:
        names = {cause} | (
            {"nav_latency", "yaw_latency"} if cause == "clock_offset" else set()
        )
        answer = Answer(verdict="data_fault", causes=(frozenset(names),))
        yield Case("fault", name, Recipe(seed=seed, faults=what), answer)


def sensors(seed: int) -> Iterator[Case]:
    """Nothing hidden but ordinary sensors: two drives, the bench, and wheels in the air."""
    for kind, name, number, how in (
        ("drive", "drive", 2 * seed, {}),
        ("drive", "drive", 2 * seed + 1, {}),
        ("bench", "bench", seed, {}),
        ("bench", "stand", seed, {"in_the_air": True, "recorder": ON_A_STAND}),
    ):
        recipe = held(ordinary(replace(nothing(kind, number), **how)))  # type: ignore[arg-type]
        hidden = list(recipe.faults)
        if name == "drive" and recipe.sensors["gyro_z"].limit < math.inf:
            hidden.append("limited_channel")
        verdict = "data_fault" if hidden else "nothing_found"
        yield Case(
            "sensors", name, recipe, Answer(verdict=verdict, causes=_only(*hidden))
        )


_DRIFTS = {
    "rotation_gain": (0.0, 0.12),
    "wheel_radius_difference": (-0.02, 0.02),
    "gyro_bias": (-0.008, 0.012),
    "process_gain": (0.0, -0.15),
    "gyro_scale": (0.0, 0.08),
}


def drifts(seed: int) -> Iterator[Case]:
    """A parameter that moves during the log, slowly or at once in the middle."""
    for name, (first, last) in _DRIFTS.items():
        recipe = Recipe(
            seed=seed,
            causes={name: last},
            drift_from={name: first},
            drift_step=seed % 2 == 1,
        )
        yield Case("drift", name, recipe, Answer(verdict="drift", causes=_only(name)))


CLASSES: Mapping[str, Callable[[int], Iterator[Case]]] = {
    "null": null,
    "single": singles,
    "pair": pairs,
    "twin": twins,
    "outside": outside,
    "fault": faults,
    "drift": drifts,
    "sensors": sensors,
}


def cases(group: str, seeds: range) -> Iterator[Case]:
    """Return all cases of one class for these seeds."""
    for seed in seeds:
        yield from CLASSES[group](seed)

"""The public vocabulary: every cause that a diagnosis can name.

The physical causes are the plant's terms (`plant/terms.csv`), in their order. Data faults have no
term, because the data are corrected, not the model.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import inf
from types import MappingProxyType
from typing import Final, Literal, cast

from hilserver.diagnosis.catalogue.candidate import StageName
from hilserver.measured.channels import GYRO, POSITION, YAW
from hilserver.plant.layout import WHEELS
from hilserver.plant.terms import TERMS, Term

Block = Literal[
    "controller", "drive", "kinematics", "navigation", "inertial", "data", "timing"
]

CONTROLLER: Final = frozenset(
    {"setpoint_rate_limit", "control_period", "controller_gains"}
)
"""Causes that act in the plant's drive but are corrected in the controller."""


SPEED_SCALES: Final[Mapping[str, str]] = MappingProxyType(
    {f"wheel.{wheel}.speed_rpm": f"shift.scale.{wheel}" for wheel in WHEELS}
)
"""By signal: factor on a wheel's speed in the log, but not in the controller."""

SPEED_STEP: Final = "encoder_quantization"
"""Term for the step in which the loop sees the wheel speeds; the values may show it as well."""

LATENCIES: Final[Mapping[str, str]] = MappingProxyType(
    {POSITION[0]: "nav_latency", YAW: "yaw_latency", GYRO: "imu_latency"}
)
"""By signal: term by which it is late; the position uses that of its first coordinate."""

OUTLIERS: Final = ("nav_outliers.share", "nav_outliers.size")
"""Parameters of outliers in the position: their share, and their distance."""

OF_THE_LOG: Final[Mapping[str, str]] = MappingProxyType(
    {"shift.nav": "clock_offset.nav"}
    | {term: f"unit_error.{signal}" for signal, term in SPEED_SCALES.items()}
)
"""Fitted like terms of the plant, but correcting the log: the parameters they become."""


@dataclass(frozen=True, slots=True)
class Cause:
    """One cause."""

    name: str
    block: Block  # where it acts, as in ``findings.json``
    parts: tuple[Term, ...]  # the main one first; data faults have parts, too
    physical: bool  # True: a term of the plant. False: a fault of the log.
    description: str

    @property
    def by_channel(self) -> bool:
        """Whether its parameters are called ``cause.<signal or source>``, one for each."""
        return not self.physical and bool(self.parts)

    @property
    def stage(self) -> StageName:
        """The replay that shows it."""
        return "drive" if self.block in ("drive", "controller") else "pose"

    @property
    def unit(self) -> str:
        """Unit of the main part."""
        return self.parts[0].unit if self.parts else "1"


def _block(term: Term) -> Block:
    return "controller" if term.cause in CONTROLLER else cast("Block", term.block)


def _physical() -> list[Cause]:
    grouped: dict[str, list[Term]] = {}
    for term in TERMS.values():
        grouped.setdefault(term.cause, []).append(term)
    return [
        Cause(
            name,
            _block(terms[0]),
            tuple(terms),
            physical=True,
            description=terms[0].description,
        )
        for name, terms in grouped.items()
    ]


_OF_THE_LOG: Final[tuple[tuple[str, Block, str, float | None, str], ...]] = (
    ("clock_offset", "timing", "s", 0.0, "delay of the time stamps of a source"),
    (
        "clock_drift",
        "timing",
        "1",
        0.0,
        "gain of the time stamps of a source per second",
    ),
    ("sign_flip", "data", "1", 1.0, "a channel has the wrong sign: factor -1"),
    ("swapped_sides", "data", "", None, "left and right sides are swapped"),
    ("unit_error", "data", "1", 1.0, "factor by which a channel is too large"),
    ("held_samples", "data", "Hz", None, "lower rate at which a channel changes"),
    (
        "interpolated_setpoint",
        "data",
        "Hz",
        None,
        "set-points were interpolated between samples",
    ),
    (
        "setpoint_as_measurement",
        "data",
        "1",
        0.0,
        "a measured channel is a copy of the set-point",
    ),
    ("dropouts", "data", "1", 0.0, "share of samples that are missing or repeated"),
    (
        "limited_channel",
        "data",
        "1",
        None,
        "largest possible reading of a channel, in its unit",
    ),
    (
        "missed_ticks",
        "timing",
        "1",
        0.0,
        "share of the recorder's ticks that were missed",
    ),
)
"""Name, block, unit (empty if it has no size), null and description."""


def _faults() -> Iterator[Cause]:
    for name, block, unit, null, text in _OF_THE_LOG:
        part = Term(name, block, unit, null, None, -inf, inf, False, "", text)
        yield Cause(
            name, block, (part,) if unit else (), physical=False, description=text
        )


CAUSES: Final[Mapping[str, Cause]] = MappingProxyType(
    {cause.name: cause for cause in (*_physical(), *_faults())}
)


def cause_of(name: str) -> Cause:
    """Return the cause that a name (``cause``, ``cause.part``, ``cause.signal``) belongs to.

    Raises
    ------
    KeyError
        If there is none.
    """
    return CAUSES[name.partition(".")[0]]


def known_part(name: str) -> Term | None:
    """Return the part that a name means, for a bare cause its first part; or None."""
    cause = CAUSES.get(name.partition(".")[0])
    if cause is None:
        return None
    found = (p for p in cause.parts if cause.by_channel or name in (p.name, cause.name))
    return next(found, None)


def part_of(name: str) -> Term:
    """Return the part that a name means.

    Raises
    ------
    KeyError
        If there is none.
    """
    if (part := known_part(name)) is None:
        raise KeyError(name)
    return part


def unit_of(name: str) -> str:
    """Return the unit of a parameter; 1 if there is no such part (``shift.nav``)."""
    part = known_part(name)
    return "1" if part is None else part.unit


def reference(cause: str, name: str) -> float | None:
    """Return how far a parameter's reference size is from null; without one, that of its cause."""
    parts = [p for p in CAUSES[cause].parts if not p.shape]
    own = next((p for p in parts if p.name == name and p.reference is not None), None)
    main = own or next((p for p in parts if p.reference is not None), None)
    if main is None or main.reference is None:
        return None
    return abs(main.reference - (main.null or 0.0))

"""The table of parameters: every number of the robot that can be set, named as in config.yaml.

Defaults, bounds, units and meanings are those of the plant's fields (`plant.quantity`) and terms
(`plant/terms.csv`), which the configuration uses as well; there is no second list. OPC UA, page,
ROS 2, scenarios, test kit, patches and the reference page read this table.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import Field, dataclass, fields
from math import isnan, nan
from typing import Final, Literal

from hilserver.body.parameters import BodyParameters, Tyre
from hilserver.plant import parts
from hilserver.plant.blocks import BlockDeclaration
from hilserver.plant.parameters import GEOMETRIC_GAINS, ROTATION_GAINS, RobotParameters
from hilserver.plant.quantity import unit_of
from hilserver.plant.terms import TERMS, Term

TERM: Final = "terms."
BODY: Final = "mechatronic"
BLOCK: Final = "blocks."
FIXED: Final = "fixed"
SECTIONS: Final[Mapping[str, type]] = {
    "plant": RobotParameters,
    "plant.controller": parts.Controller,
    "plant.process": parts.Process,
    "sensors.imu": parts.Imu,
    "sensors.battery": parts.Battery,
    "sensors.tof": parts.RangeFinders,
    "sensors.nav": parts.Navigation,
    BODY: BodyParameters,
    f"{BODY}.tyre": Tyre,
}
"""Classes whose fields are parameters, by their section of config.yaml."""

JUMPS: Final[Mapping[str, tuple[str, ...]]] = {
    "duty": (
        *("wheel.*.demand_rpm", "wheel.*.duty_pct"),
        *("battery.*_v", "battery.*_a", "shield.temperature_degc"),
    ),
    "speed": ("wheel.*.speed_rpm",),
    "velocity": ("velocity.*", "imu.*"),
    "imu": ("imu.*",),
    "battery": ("battery.*_v", "battery.*_a"),
    "tof": ("tof.*",),
    "nav": ("nav.*",),
}
"""Outputs that jump in the tick of a change, by the words used in the plant's fields."""

FLAG: Final = (("false", 0.0), ("true", 1.0))
EXCLUSIVE: Final = "plant.exclusive_twist"
GAIN: Final = "kinematics.rotation_gain"
WIDEST: Final = 1e12  # bound of numbers without one of their own

When = Literal["tick", "restart"]


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number that can be set."""

    name: str  # as in config.yaml; those of ``plant.terms`` begin with ``terms.``
    unit: str  # its symbol, "1" without one
    # range; where an end is excluded, it is refused with a message
    low: float
    high: float
    default: float  # NaN: null
    nullable: bool  # whether it may be null
    meaning: str
    # words of `JUMPS`, or outputs, that may jump in the tick of a change
    jumps: str = ""
    when: When = "tick"  # when a change takes effect
    # values that have a name, which stands for them
    names: tuple[tuple[str, float], ...] = ()

    @property
    def outputs(self) -> tuple[str, ...]:
        """Patterns of the outputs that may jump."""
        return tuple(
            name for word in self.jumps.split() for name in JUMPS.get(word, (word,))
        )

    @property
    def range_text(self) -> str:
        """The range in words."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.low:g} .. {self.high:g}{unit}" + (
            " or null" if self.nullable else ""
        )

    @property
    def is_flag(self) -> bool:
        """Whether it is 0 (false) or 1 (true), and nothing else."""
        return self.names == FLAG

    @property
    def names_text(self) -> str:
        """The named values in words; empty: none."""
        if self.is_flag or not self.names:
            return ""
        return "by name " + ", ".join(
            name if isnan(value) else f"{name} {value:g}" for name, value in self.names
        )


def _of_field(section: str, item: "Field[object]") -> Parameter:
    about = item.metadata
    bounds = item.metadata["bounds"]
    low = bounds.get("ge", bounds.get("gt", -WIDEST))
    high = bounds.get("le", bounds.get("lt", WIDEST))
    return Parameter(
        name=f"{section}.{item.name}",
        unit=about["unit"] or unit_of(item.name),
        low=low,
        high=high,
        default=float(item.default),  # type: ignore[arg-type]
        nullable="None" in str(item.type),
        meaning=about["meaning"],
        jumps=about["jumps"],
        when="restart" if section.startswith(BODY) else "tick",
    )


def _of_term(term: Term) -> Parameter:
    default = nan if term.null is None else term.null
    return Parameter(
        name=f"{TERM}{term.name}",
        unit=term.unit,
        low=term.low,
        high=term.high,
        default=default,
        nullable=term.null is None,
        meaning=term.description,
        jumps=term.jumps,
    )


def gains(geometric: str = GEOMETRIC_GAINS[0]) -> tuple[tuple[str, float], ...]:
    """Return the values of K_om by name; `geometric`: the name that null stands for."""
    return (*ROTATION_GAINS.items(), (geometric, nan))


def _of_kinematics() -> Iterator[Parameter]:
    text = "1: drive only the larger part of a twist with both (5.4)"
    yield Parameter(EXCLUSIVE, "1", 0.0, 1.0, 0.0, False, text, "duty", names=FLAG)
    jumps = "velocity duty"
    text = "K_om; null: from the geometry, geometric_skid unless configured as geometric_diff"
    yield Parameter(GAIN, "1/m", 1e-6, 1e6, nan, True, text, jumps, names=gains())
    text = "-1: right-handed; 1: as the thesis prints it"
    yield Parameter("kinematics.yaw_sign", "1", -1.0, 1.0, -1.0, False, text, jumps)


def _of_plant() -> Iterator[Parameter]:
    for section, part in SECTIONS.items():
        for item in fields(part):
            if item.metadata.get("jumps", FIXED) != FIXED:
                yield _of_field(section, item)
    yield from _of_kinematics()
    yield from map(_of_term, TERMS.values())


PLANT: Final[Mapping[str, Parameter]] = {p.name: p for p in _of_plant()}
"""Parameters of every robot by name."""


def block_parameters(name: str, declared: BlockDeclaration) -> Iterator[Parameter]:
    """Yield the parameters of one of the user's own blocks."""
    outputs = " ".join(f"{name}.{output.name}" for output in declared.outputs)
    for key, default in declared.parameters.items():
        text = f"parameter of the block {name}"
        path = f"{BLOCK}{name}.{key}"
        yield Parameter(path, "1", -WIDEST, WIDEST, default, False, text, outputs)


def table_of(
    blocks: Iterable[tuple[str, BlockDeclaration]] = (),
) -> dict[str, Parameter]:
    """Return the parameters of a robot with these own blocks, by name."""
    own = [p for name, declared in blocks for p in block_parameters(name, declared)]
    return dict(PLANT) | {p.name: p for p in own}

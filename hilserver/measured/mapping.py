"""Mapping files: which column, or topic and field, of a foreign log is which signal."""

from importlib import resources
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from hilserver.config.loading import load, place
from hilserver.config.plant import PlantConfig
from hilserver.config.section import Section
from hilserver.errors import ConfigError, LogError, meant
from hilserver.logs.reading import refuse_others
from hilserver.measured.builtin import builtin_folder, builtin_mappings
from hilserver.measured.names import conversion, mapped_units, units_of

DATED = "iso"
PER_SECOND = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, DATED: 1e-9}
ANY_NUMBER = "1"  # unit of a bare number, which `scale` turns into the signal's unit


class TimeMap(Section):
    """Where the stamps are."""

    column: str | None = Field(None, description="time column of a table; default t_s")
    unit: Literal["s", "ms", "us", "ns", "iso"] | None = Field(
        None,
        description="its unit; default: what the file says (type, row of units, name), else s;"
        " iso: dates, as 2026-11-25T12:00:00.020",
    )
    rest: str | None = Field(
        None,
        description="second column of the time: nanosec beside sec, a time of day beside a date",
    )
    rest_unit: Literal["s", "ms", "us", "ns"] | None = Field(
        None,
        description="its unit, if it holds numbers; default: what the file says, else ns",
    )
    rate_hz: float | None = Field(
        None,
        gt=0,
        le=1e6,
        description="if the file has no time stamps: rate of the rows; delays are then not judged",
    )
    stamp: Literal["received", "header"] = Field(
        "received",
        description="bags: time of reception by the recorder, or header.stamp",
    )

    @model_validator(mode="after")
    def _one_of_them(self) -> Self:
        if self.column is not None and self.rate_hz is not None:
            raise ValueError(
                "column and rate_hz exclude each other; remove one of them"
            )
        if self.rest is not None and self.column is None:
            raise ValueError("rest belongs to a column; name the column, too")
        return self


class ColumnMap(Section):
    """A column of whole numbers."""

    column: str = Field(description="its name in the file")


class ChannelMap(Section):
    """Where a signal comes from; unit, sign, scale, offset are applied in this order."""

    column: str | None = Field(None, description="column of a table")
    topic: str | None = Field(None, description="topic of a bag, instead of a column")
    field: str | None = Field(
        None,
        description="number in the message: a.b.c, list[2] or list[name]; quaternion.yaw is"
        " computed",
    )
    unit: str | None = Field(
        None,
        description="default: what the file says (row of units, name), else that of the signal;"
        " 1: any, see scale",
    )
    sign: Literal[-1, 1] = Field(1, description="-1 reverses it")
    scale: float | None = Field(None, description="factor, applied after the unit")
    offset: float = Field(0.0, description="added last, in the unit of the signal")
    optional: bool = Field(default=False, description="true: may be missing from a log")

    @model_validator(mode="after")
    def _column_or_topic(self) -> Self:
        if (self.column is None) == (self.topic is None):
            raise ValueError("a channel needs either column or topic and field")
        if (self.topic is None) != (self.field is None):
            raise ValueError("topic and field belong together; write both")
        if self.scale == 0.0:
            raise ValueError("scale must not be 0; write the factor")
        return self


class OdometryMap(Section):
    """The dimensions with which a driver made odometry of its wheels' speeds."""

    track_m: float | None = Field(None, gt=0, description="null: unknown")
    wheel_radius_m: float | None = Field(None, gt=0, description="null: unknown")


class ReferenceMap(Section):
    """What shows the pose."""

    by: Literal["tracking", "map"] = Field(
        "tracking",
        description="tracking: cameras or radio tags; map: SLAM, AMCL, scan matching, whose errors"
        " last and jump where it corrects itself. Latitude and longitude need no entry",
    )


class LogMapping(Section):
    """A mapping file."""

    time: TimeMap = Field(
        default_factory=TimeMap, description="source of the time stamps"
    )
    segment: ColumnMap | None = Field(None, description="column that numbers the runs")
    block: ColumnMap | None = Field(
        None, description="column that numbers the blocks held out together"
    )
    plant: PlantConfig = Field(
        default_factory=PlantConfig,
        description="keys of the plant configuration that describe this machine",
    )
    odom: OdometryMap = Field(
        default_factory=OdometryMap,
        description="for odom.linear_m_s and odom.angular_rad_s, which stand for wheel speeds",
    )
    reference: ReferenceMap = Field(
        default_factory=ReferenceMap, description="what shows the position and heading"
    )
    channels: dict[str, ChannelMap] = Field(min_length=1, description="by signal name")

    @property
    def plant_keys(self) -> dict[str, Any]:
        """The keys that the file sets, and those that follow from them.

        A track without a wheelbase means two wheels, which turn at 1/track about their axle.
        """
        keys = self.plant.model_dump(exclude_unset=True)
        if "track_m" in keys:
            keys.setdefault("wheelbase_m", None)
        if keys.get("wheelbase_m", ...) is None:
            two_wheels = {
                "drive": "skid",
                "icr_offset_m": 0.0,
                "rotation_gain": "geometric_diff",
            }
            keys = two_wheels | keys
        return keys

    @property
    def is_for_bags(self) -> bool:
        """Whether it names topics, not columns."""
        return any(channel.topic is not None for channel in self.channels.values())

    def factor(self, signal: str, said: str | None = None) -> float:
        """Return the factor for the numbers of a channel.

        `said`: the unit that the file says, for a channel without one.
        """
        channel = self.channels[signal]
        wanted = mapped_units()[signal]
        unit = wanted if channel.unit in (None, ANY_NUMBER) else str(channel.unit)
        if channel.unit is None and channel.scale is None and said is not None:
            unit = said
        factor = conversion(unit, wanted)
        if factor is None:
            raise ValueError(unit)
        scale = 1.0 if channel.scale is None else channel.scale
        return factor * channel.sign * scale


def load_mapping(mapping: Path | str) -> LogMapping:
    """Read a mapping file, or a built-in one by name; LogError has one line per complaint."""
    if str(mapping) in builtin_mappings():
        with resources.as_file(builtin_folder() / f"{mapping}.yaml") as path:
            return _load(path)
    path = Path(mapping)
    if not path.exists():
        known = ", ".join(builtin_mappings())
        raise LogError(f"{path}: no such mapping file; built-in mappings are {known}")
    refuse_others(path)
    return _load(path)


def _load(path: Path) -> LogMapping:
    try:
        result = load(path, LogMapping)
        complaints = []
        for name, channel in result.channels.items():
            found = _complaint(name, channel)
            if found is not None:
                key, complaint = found
                complaints.append(f"{place(path, ('channels', name, *key))}{complaint}")
        if {c.topic is None for c in result.channels.values()} == {True, False}:
            complaints.append(
                f"{place(path, ('channels',))}a log is either a table or a bag; use only columns"
                " or only topics"
            )
    except ConfigError as error:
        raise LogError(str(error)) from None
    if complaints:
        raise LogError("\n".join(complaints))
    return result


def _complaint(name: str, channel: ChannelMap) -> tuple[tuple[str, ...], str] | None:
    """Return key and sentence of an error in a channel, or None."""
    known = mapped_units()
    if name not in known:
        hint = meant(name, known, "see 'hilserver signals' for the names")
        return (), f"there is no such signal; {hint}"
    wanted = known[name]
    if channel.unit == ANY_NUMBER and channel.scale is not None:
        return None
    if channel.unit is not None and conversion(channel.unit, wanted) is None:
        fitting = ", ".join(units_of(wanted))
        return ("unit",), (
            f"unit '{channel.unit}' does not fit a signal in {wanted}; write one of {fitting},"
            " or 1 with a scale"
        )
    return None

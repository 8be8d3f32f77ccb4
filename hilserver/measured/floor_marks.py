"""A mark on the floor: where a robot was at a known time, as measured with a tape.

It is a place, the same place as at another time, or a distance from the place at another time.
"""

from dataclasses import dataclass
from typing import Self

from pydantic import Field, model_validator

from hilserver.config.section import Section


class FloorMark(Section):
    """Where the robot was at one time."""

    t_s: float = Field(description="time of the log")
    segment: int | None = Field(
        None, description="run, if several contain this time; as in the log"
    )
    x_m: float | None = Field(None, description="place, in a frame of your choice")
    y_m: float | None = Field(None, description="belongs to x_m")
    same_as_t_s: float | None = Field(
        None, description="the robot is where it was at this time"
    )
    from_t_s: float | None = Field(
        None, description="forward_m is measured from the place at this time"
    )
    forward_m: float | None = Field(
        None,
        ge=-1000,
        le=1000,
        description="straight distance from there; negative: driven backwards",
    )
    yaw_rad: float | None = Field(
        None,
        ge=-7.0,  # a square is one turn, and a little more; larger ones are degrees
        le=7.0,
        description="heading; of a relative mark: minus the heading at that time",
    )
    sd_m: float = Field(
        gt=0, le=100, description="standard deviation of place or distance"
    )
    yaw_sd_rad: float = Field(
        0.02, gt=0, le=3.2, description="standard deviation of yaw_rad"
    )

    @property
    def other_t_s(self) -> float | None:
        """The time that a relative mark refers to."""
        return self.from_t_s if self.same_as_t_s is None else self.same_as_t_s

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        for one, other in (("x_m", "y_m"), ("from_t_s", "forward_m")):
            if (getattr(self, one) is None) != (getattr(self, other) is None):
                raise ValueError(f"{one} and {other} belong together; write both")
        kinds = (self.x_m, self.same_as_t_s, self.from_t_s)
        if sum(kind is not None for kind in kinds) != 1:
            raise ValueError(
                "a mark needs exactly one of: x_m and y_m; same_as_t_s; from_t_s and forward_m"
            )
        return self


@dataclass(frozen=True, slots=True)
class PlacedMark:
    """A mark and the run that it belongs to."""

    span: int  # index into `MeasuredLog.spans`
    mark: FloorMark

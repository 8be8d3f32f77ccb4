"""What a requirement is, as written in a sweep, in a test and for ``simulate --require``.

::

    require:
      - {name: stays on the path, signal: path.error_m, below: 0.15, always: true}
      - {name: arrives, signal: pose.x_m, above: 4.9, within_s: 40}
      - {name: comfortable, python: checks.py:jerk, below: 3.0}
"""

from pathlib import Path
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from hilserver.config.loading import LIVE_BYTES, load
from hilserver.config.section import Section

MAX_REQUIREMENTS = 100
LONGEST_S = 86_400.0
Time = Annotated[float, Field(ge=0, le=LONGEST_S)]


class Requirement(Section):
    """What has to be true of one signal, when and for how long.

    With ``within_s`` it has to become true between ``after_s`` and ``within_s``, else it has to be
    true at ``after_s``. From then on it has to stay true for ``for_s``, or until the end with
    ``always``. With neither, one moment suffices if ``within_s`` is given, else it is to the end.
    """

    name: str = Field(
        min_length=1, max_length=100, description="description, for people"
    )
    signal: str | None = Field(None, description="a scalar signal")
    python: str | None = Field(
        None,
        description="file.py:function or module:function, in place of signal; it takes the drive, a"
        " mapping of signals to arrays with time_s and period_s, and returns a number or an array"
        " with a value for each tick",
    )
    signals: tuple[str, ...] = Field(
        (),
        description="with python: the signals it reads; without, every signal is kept for it",
    )
    below: float | None = Field(None, description="no sample is above this")
    above: float | None = Field(None, description="no sample is below this")
    equals: float | None = Field(None, description="all samples equal this")
    tolerance: float = Field(0.0, ge=0, description="with equals: allowed deviation")
    always: bool = Field(False, description="true until the end of the drive")
    within_s: Time | None = Field(
        None, description="must become true by then, from the start [s]"
    )
    after_s: Time = Field(
        0.0, description="ignored before this time, from the start [s]"
    )
    for_s: Time | None = Field(None, description="stays true for this long [s]")
    share: float = Field(
        1.0,
        gt=0,
        le=1,
        description="share of a sweep's machines that must meet it, for JUnit",
    )

    @model_validator(mode="after")
    def _is_complete(self) -> Self:
        if (self.signal is None) == (self.python is None):
            raise ValueError(f"'{self.name}' needs either signal or python")
        if self.signals and self.python is None:
            raise ValueError(
                f"'{self.name}': signals goes with python; write one signal"
            )
        bounds = [self.below, self.above]
        if (self.equals is None) == (bounds == [None, None]):
            raise ValueError(f"'{self.name}' needs below, above or both, or equals")
        if (
            self.above is not None
            and self.below is not None
            and self.above > self.below
        ):
            raise ValueError(
                f"'{self.name}': nothing is above {self.above:g} and below {self.below:g}"
            )
        if self.tolerance and self.equals is None:
            raise ValueError(f"'{self.name}': tolerance goes with equals")
        if self.always and self.for_s is not None:
            raise ValueError(f"'{self.name}': give always or for_s, not both")
        if self.within_s is not None and self.within_s < self.after_s:
            raise ValueError(
                f"'{self.name}': within_s is {self.within_s:g}, it must be at least"
                f" {self.after_s:g} (after_s); both count from the start"
            )
        return self

    @property
    def lasts_s(self) -> float:
        """Least length of a drive for this requirement [s]."""
        return self.after_s + (self.for_s or 0.0)


class _File(BaseModel):
    """A file with requirements; as a sweep is one, other keys are allowed."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)
    require: tuple[Requirement, ...] = Field(min_length=1, max_length=MAX_REQUIREMENTS)


def load_requirements(path: Path) -> tuple[Requirement, ...]:
    """Return the requirements of a file, or ConfigError; `Judge` looks up their signals."""
    return load(path, _File, LIVE_BYTES).require

"""The evidence behind the findings: the arrays and tables that the report draws.

The engine fills it at full resolution; the report decimates. Everything here is plain data, so an
`Evidence` can travel between processes.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from hilserver.arrays import Array, Indices
from hilserver.config.patch import FittedIn
from hilserver.diagnosis.schema.decisions import ScreenRow
from hilserver.diagnosis.schema.findings import Findings, Gain, Parameter
from hilserver.plant.parameters import RobotParameters


@dataclass(frozen=True, slots=True)
class ChannelSeries:
    """One measured channel and both models, at the stamps of its samples.

    Angles are unwrapped.
    """

    # signal (``nav.yaw_rad``) and symbol of its unit
    name: str
    unit: str
    # shape (n,): `simulated` is the configured plant after corrections of data faults
    t_s: Array
    measured: Array
    simulated: Array
    # shape (n,): the plant with the terms of the extension; None when there is none
    extended: Array | None
    run: Indices  # shape (n,): the models begin anew where it rises; never decreases


@dataclass(frozen=True, slots=True)
class Path:
    """The path over the floor in one span; each track has shape (n, 2) of x, y [m]."""

    span: int
    measured: Array
    simulated: Array
    extended: Array | None
    # rows at which the models begin anew, without the first
    begins: tuple[int, ...] = ()
    group: str = ""  # of logs; empty without groups

    @property
    def size_m(self) -> float:
        """Diagonal of the area that it covers."""
        across_m = np.nanmax(self.measured, axis=0) - np.nanmin(self.measured, axis=0)
        return float(np.hypot(*across_m))


@dataclass(frozen=True, slots=True)
class MarkedEnds:
    """Where each model's runs end, seen from their marks on the floor [m]; shape (n, 2)."""

    # forward and to the left, as the robot stood at the beginning of the run
    simulated: Array
    extended: Array | None


@dataclass(frozen=True, slots=True)
class CutRow:
    """Residual of a channel when the replay begins at a cut point: it shows the faulty block."""

    # ``setpoints`` (whole chain), ``duty`` (process only) or ``speed`` (kinematics only)
    cut: str
    channel: str
    unit: str
    # of the residual, and what the sensors' noise alone would give, in `unit`
    rms: float
    expected: float | None


@dataclass(frozen=True)
class Similarity:
    """|cos| between the sensitivities of causes, noise-weighted, nuisances projected out."""

    names: tuple[str, ...]  # causes (or ``cause.part``), n of them
    cosine: Array  # shape (n, n): signed; NaN where a sensitivity is zero
    limit: float = 0.95  # above it, two causes form a group


@dataclass(frozen=True, slots=True)
class HorizonRow:
    """Gain at the end of free runs of one length, on held-out blocks."""

    # key of ``Findings.total_gain``: position_m, yaw_rad, speed_rpm, duty_pct or gyro_z_rad_s
    quantity: str
    gain: Gain


@dataclass(frozen=True, slots=True)
class Dependence:
    """The remaining residual against one regressor, in bins."""

    # residual of which signal, and against what (``pose.yaw_rad``, ``t_s``)
    channel: str
    unit: str
    regressor: str
    regressor_unit: str
    # shape (k,): middle of the bin, mean residual and its 95 % interval, which counts blocks
    x: Array
    mean: Array
    low: Array
    high: Array
    # as in the screen, among all structures
    statistic: float
    critical: float


@dataclass(frozen=True, slots=True)
class Course:
    """A parameter fitted in windows of time, for drift; all of shape (k,)."""

    cause: str
    unit: str
    t_s: Array
    value: Array
    low: Array
    high: Array


@dataclass(frozen=True, slots=True)
class FittedTerm:
    """A term of the extension: what goes into ``model_patch.yaml``."""

    name: str  # as in ``plant/terms.csv``; for a group, the member that was fitted
    parameter: Parameter


@dataclass(frozen=True)
class Evidence:
    """All that the report shows besides the findings; missing parts are empty."""

    series: tuple[ChannelSeries, ...] = ()
    paths: tuple[Path, ...] = ()
    marked_ends: MarkedEnds | None = None
    cuts: tuple[CutRow, ...] = ()
    screen: tuple[ScreenRow, ...] = ()
    similarity: Similarity | None = None
    gain_by_horizon: tuple[HorizonRow, ...] = ()
    dependences: tuple[Dependence, ...] = ()
    courses: tuple[Course, ...] = ()
    extension: tuple[FittedTerm, ...] = ()
    # what the machine did in the data that the extension was fitted to
    fitted: FittedIn = field(default_factory=FittedIn)
    timings_s: Mapping[str, float] = field(default_factory=dict)  # wall time by stage
    # what a reader of the evidence should know, in sentences
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Diagnosis:
    """What a diagnosis returns: the findings, and the evidence for them."""

    findings: Findings
    evidence: Evidence = field(default_factory=Evidence)
    # the machine of the logs as it was configured; None where nothing was fitted to it
    robot: RobotParameters | None = None

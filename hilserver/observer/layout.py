"""The layout of the observer's numbers: its constants `c`, and all that its future depends on.

`c` is `FilterFigures`, followed by one `plant.layout.Parameters` for each direction in which the
parameters are uncertain. The filter's own numbers are a `Head`, followed by a ring of `Moment`s in
which the newest replaces the oldest; a copy is a snapshot.
"""

from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray

from hilserver.compiled.records import Record
from hilserver.plant.layout import Parameters

X, Y, YAW, V, OM, BIAS, OU_X, OU_Y, OU_YAW, SLIP, GAIN = range(11)
"""States: pose [m, m, rad, not wrapped], speed [m/s], turn rate [rad/s], bias of the gyro [rad/s],
the navigation's correlated errors [m, m, rad], and the relative deviations of speed and turn rate
from those of the wheels."""
N_ESTIMATED: Final = 11
MOST_DIRECTIONS: Final = 12  # directions in which uncertain parameters are considered
CONSIDERED: Final = MOST_DIRECTIONS + 1
"""These, and the instant within a step at which the wheels follow their set-points."""
MOMENTS: Final = 128  # past states that are kept; older samples are not accepted
OLDEST_S: Final = 1.0  # maximum age of a sample
SILENT_S: Final = 1.0
"""Time without a sample of the navigation after which the robot runs on dead reckoning."""

PLACE, HEADING = range(2)  # what the navigation shows
NO_FIX, CONVERGING, TRACKING, DEAD_RECKONING = range(4)  # values of `estimate.state`

Vector = Annotated[NDArray[np.float64], N_ESTIMATED]
Square = Annotated[NDArray[np.float64], (N_ESTIMATED, N_ESTIMATED)]
Directions = Annotated[NDArray[np.float64], CONSIDERED]
Pair = Annotated[NDArray[np.float64], 2]
Cross = Annotated[NDArray[np.float64], (N_ESTIMATED, CONSIDERED)]


class FilterFigures(Record):
    """How noisy the sensors are, and how uncertain the states are at the start."""

    directions: float  # of uncertain parameters in use
    considered: float  # the same, plus one for the wheels' instant if `instant_sd` > 0
    instant_sd: float  # see `figures.INSTANT_SD`
    nav_period: float  # [s] of the slice in which its latency is counted
    imu_period: float  # [s]
    # consecutive refused samples until the robot counts as carried
    readmit_after: float
    wheel_sd: float  # [rad/s] of the mean speed of a side, one sample
    # [rad2/s]: the part correlated in time, as variance of the angle per s
    wheel_drift: float
    gyro_sd: float  # [rad/s]
    gyro_drift: float  # [rad2/s]
    position_sd: float  # [m] of one sample
    position_ou: float  # [m] correlated in time
    position_tau: float  # [s]
    yaw_sd: float  # [rad]
    yaw_ou: float  # [rad]
    yaw_tau: float  # [s]
    bias_sd: float  # [rad/s] at the start
    bias_walk: float  # [rad2/s3]
    slip_sd: float  # at the start
    slip_walk: float  # [1/s]
    gain_sd: float
    gain_walk: float  # [1/s]
    # variance per metre rolled of what no term describes
    roam: float  # [m] of the position
    roam_yaw: float  # [rad2/m] of the heading


class Head(Record):
    """Place of the newest moment, counters, and work space."""

    newest: float  # row of the ring
    count: float  # moments in the ring
    redo: float  # how many past moments to compute again, for a late sample
    accepted: float  # samples of position and yaw
    rejected: float  # by their innovation
    readmitted: float  # times that the robot was found carried
    doubted: float  # times that the pose was less certain than its covariance said
    late: float  # samples that were too old
    restarts: float  # restarts because a number was no longer finite
    seen_gyro: float  # counter of its last sample
    seen_position: float
    # derivatives of a sensor by state
    rows: Annotated[NDArray[np.float64], (2, N_ESTIMATED)]
    shared: Annotated[NDArray[np.float64], (2, CONSIDERED)]  # and by direction
    weight: Vector  # covariance of the state with one reading
    weight_shared: Directions
    # effect of the wheels' noise on a step
    noise: Annotated[NDArray[np.float64], (5, N_ESTIMATED)]
    push: Cross  # effect of each direction on a step


class Moment(Record):
    """The robot at one moment: its readings, and the estimate from them."""

    time: float  # [s]
    left: float  # mean speed that the left wheels' encoders show [rad/s]
    right: float
    angle_left: float  # [rad]
    apart_left: float  # [rad/s]: front minus rear wheel of a side
    apart_right: float
    bend_left: float  # [rad/s]: change of slope from the step before, times the step
    bend_right: float
    turning: float  # [rad/s2]: angular acceleration in the step
    has_gyro: float
    gyro: float  # [rad/s]
    gyro_back: float  # [s]: how much older the sample is than the moment
    has_position: float
    position: Annotated[NDArray[np.float64], 2]  # [m]
    position_back: float  # [s]
    has_yaw: float
    yaw: float  # [rad]
    yaw_back: float  # [s]
    # of position and heading each, see `PLACE`
    fixed: Pair  # flag: a sample has been accepted
    refused: Pair  # consecutive samples
    agreeing: Pair  # how many of the last of these agree with each other
    came: Pair  # [s] when the last sample came, accepted or not
    rolled: Pair  # [m, rad] since the last accepted sample, see `filter.rolling`
    rolled_before: Pair  # the same when the last refused sample came
    reach: Pair  # the same when the first refused sample came
    off: Annotated[
        NDArray[np.float64], 3
    ]  # innovations of the last refused [m, m, rad]
    carried: float  # flag: at this moment the robot was found carried
    surprise: Pair  # NIS of the samples of this moment, as `nis`; NaN: none
    misfit: float  # minus twice the log-likelihood of all samples until now
    last_fix: float  # [s] of the last accepted sample
    nis: float  # of the last sample, divided by its number of values: 1 on average
    estimate: Vector
    covariance: Square
    cross: Cross  # covariance of the state with the directions, each of variance 1


class Shown(Record):
    """The signals estimate.*, in the order of the table."""

    x: float  # [m]
    y: float
    yaw: float  # [rad]
    linear: float  # [m/s]
    angular: float  # [rad/s]
    gyro_bias: float  # [rad/s]
    deviations: Annotated[NDArray[np.float64], 6]  # standard deviations of these six
    x_y: float  # covariances [m2], [m rad]
    x_yaw: float
    y_yaw: float
    nis: float
    state: float
    rejected: float


class ShownStatus(Shown, word=np.int64):
    """The OPC UA status code of each."""


FIGURES: Final = FilterFigures.layout
HEAD: Final = Head.layout
MOMENT: Final = Moment.layout
SHOWN: Final = Shown.layout
N_FIGURES: Final = FilterFigures.n_words
N_PARAMETERS: Final = Parameters.n_words
N_HEAD: Final = Head.n_words
N_MOMENT: Final = Moment.n_words
N_FILTER: Final = N_HEAD + MOMENTS * N_MOMENT

"""Corrects the estimate with samples, and rejects samples that are too far off.

Uncertain parameters are considered, not estimated (Schmidt's filter): only the state has a gain, so
their variance stays and keeps what depends on them uncertain.
"""

import math
from typing import Any

from hilserver.compiled import inlined, part
from hilserver.compiled.records import record_at
from hilserver.observer.layout import (
    BIAS,
    FIGURES,
    GAIN,
    HEADING,
    N_ESTIMATED,
    OU_X,
    OU_Y,
    OU_YAW,
    PLACE,
    SILENT_S,
    SLIP,
    YAW,
    FilterFigures,
    Head,
    Moment,
    X,
    Y,
)
from hilserver.observer.motion import rolled
from hilserver.observer.sensors import (
    gyro_row,
    gyro_shared,
    position_rows,
    position_shared,
    show_gyro,
    show_position,
    show_yaw,
    yaw_row,
    yaw_shared,
)
from hilserver.plant.layout import Parameters
from hilserver.plant.pose import wrap

GATE_1, GATE_2 = 15.137, 18.421
"""Normalised squared innovations (1 and 2 values) that 1 of 10,000 good samples exceeds."""
REACH = 2.0
"""A robot that drives is off from where its wheels place it by at most this times what they rolled:
it stood while they spun, or it went the other way. What is farther off was carried, by more than
the same share of a wheel's radius: wheels are read a little late."""
FAR = 4.0  # standard deviations of a sample within which two samples agree
AGREEING = 3.0  # samples that show together that the estimate is wrong
OUTLIER, DOUBTFUL, CARRIED = range(3)  # what a sample that does not fit means
ONE_OF, WIDE = 100.0, 10.0
"""For the likelihood, one sample of so many has a noise so many times larger."""
N_NEARER = 3  # steps towards a heading that is not known
_UNLIKELY, _TINY = 1e-300, 1e-12
WHOLE = 1.0  # largest variance of slip and rotation gain: all of the motion
# variances of an unknown place and an unknown heading
UNKNOWN_M2, UNKNOWN_RAD2 = 1e6, 1e2


@part
def _weigh(m: Moment, n: int, row: int, h: Head) -> None:
    """Write the covariance of state and directions with a reading to `h`."""
    for i in range(N_ESTIMATED):
        total = 0.0
        for j in range(N_ESTIMATED):
            total += m.covariance[i, j] * h.rows[row, j]
        for j in range(n):
            total += m.cross[i, j] * h.shared[row, j]
        h.weight[i] = total
    for j in range(n):
        total = h.shared[row, j]
        for i in range(N_ESTIMATED):
            total += m.cross[i, j] * h.rows[row, i]
        h.weight_shared[j] = total


@inlined
def _spread(n: int, row: int, h: Head) -> float:
    """Return the covariance of the weighed reading with that of `row`, without noise."""
    total = 0.0
    for i in range(N_ESTIMATED):
        total += h.rows[row, i] * h.weight[i]
    for j in range(n):
        total += h.shared[row, j] * h.weight_shared[j]
    return total


@part
def _correct(m: Moment, n: int, h: Head, innovation: float, variance: float) -> None:
    """Apply the reading that was weighed."""
    share = 1.0 / variance
    for i in range(N_ESTIMATED):
        gain = h.weight[i] * share
        m.estimate[i] += gain * innovation
        for j in range(N_ESTIMATED):
            m.covariance[i, j] -= gain * h.weight[j]
        for j in range(n):
            m.cross[i, j] -= gain * h.weight_shared[j]


@inlined
def forget(m: Moment, place: int, variance: float) -> None:
    """Make a state unknown, uncorrelated with all others."""
    for i in range(N_ESTIMATED):
        m.covariance[place, i] = m.covariance[i, place] = 0.0
    for j in range(m.cross.shape[1]):
        m.cross[place, j] = 0.0
    m.covariance[place, place] = variance


@inlined
def _weigh_up(m: Moment, n: int, spread: float, nis: float) -> None:
    """Count how likely `n` values were; `spread` is the determinant of their covariance."""
    good = (1.0 - 1.0 / ONE_OF) * math.exp(-0.5 * nis)
    wide = math.exp(-0.5 * nis / (WIDE * WIDE)) / (ONE_OF * WIDE**n)
    m.misfit += math.log(spread) - 2.0 * math.log(max(good + wide, _UNLIKELY))


@part
def _judged(
    m: Moment,
    kind: int,
    off: float,
    apart: float,
    sd: float,
    radius: float,
    after: float,
) -> int:
    """Return what a sample means whose innovation is too large.

    A robot was carried if samples that agree with each other show it where its wheels cannot have
    taken it. If these can have, the estimate was less certain than its covariance said. After a
    silence, one sample shows that: nothing else has confirmed the estimate.

    Parameters
    ----------
    kind : int
        `PLACE` or `HEADING`.
    off, apart : float
        Sizes of the innovation, and of its difference from that of the last refused sample.
    sd : float
        Standard deviation of a sample.
    radius : float
        Radius of a wheel, or by how much the robot turns if its wheels roll that far.
    after : float
        Refused samples in a row after which the estimate has to be wrong.
    """
    was_silent = m.time - m.came[kind] > SILENT_S
    m.came[kind] = m.time
    if m.refused[kind] == 0.0:
        m.reach[kind] = m.rolled[kind]
    since = m.rolled[kind] - m.rolled_before[kind]
    agrees = m.refused[kind] > 0.0 and apart <= FAR * sd + REACH * since
    m.agreeing[kind] = m.agreeing[kind] + 1.0 if agrees else 1.0
    m.refused[kind] += 1.0
    m.rolled_before[kind] = m.rolled[kind]
    do_agree, is_late = m.agreeing[kind] >= AGREEING, m.refused[kind] >= after
    near = FAR * sd + REACH * m.reach[kind]
    if off > near + REACH * radius:
        return CARRIED if do_agree and is_late else OUTLIER
    if off > near:
        return DOUBTFUL if is_late else OUTLIER
    return DOUBTFUL if do_agree or is_late or was_silent else OUTLIER


@inlined
def _doubt(m: Moment, scale: float) -> None:
    """Let the variance of the pose, and of what the wheels leave open, grow by a factor."""
    # corrections leave what rounding has made asymmetric, and each doubt would make it grow
    for i in range(N_ESTIMATED):
        for j in range(i):
            mean = 0.5 * (m.covariance[i, j] + m.covariance[j, i])
            m.covariance[i, j] = m.covariance[j, i] = mean
    for i, most in (
        (X, UNKNOWN_M2),
        (Y, UNKNOWN_M2),
        (YAW, UNKNOWN_RAD2),
        (SLIP, WHOLE),
        (GAIN, WHOLE),
    ):
        least = max(1.0, most / max(m.covariance[i, i], _TINY))
        factor = math.sqrt(min(scale, least))
        for j in range(N_ESTIMATED):
            m.covariance[i, j] *= factor
            m.covariance[j, i] *= factor
        for j in range(m.cross.shape[1]):
            m.cross[i, j] *= factor


@inlined
def _accept(m: Moment, kind: int) -> None:
    m.fixed[kind] = 1.0
    m.last_fix = m.time
    m.came[kind] = m.time
    m.refused[kind] = 0.0
    m.agreeing[kind] = 0.0
    m.rolled[kind] = 0.0
    m.rolled_before[kind] = 0.0


@part
def take_gyro(p: Parameters, c: Any, h: Head, m: Moment, dt: float) -> None:
    """Correct with the turn rate that the gyro shows."""
    figures = record_at(c, 0, FIGURES)
    n = int(figures.considered)
    gyro_row(p, h.rows[0])
    gyro_shared(p, c, m, h)
    _weigh(m, n, 0, h)
    variance = (
        _spread(n, 0, h) + figures.gyro_sd * figures.gyro_sd + figures.gyro_drift / dt
    )
    innovation = m.gyro - show_gyro(p, m.estimate, m.gyro_back, m.turning)
    _weigh_up(m, 1, variance, innovation * innovation / variance)
    _correct(m, n, h, innovation, variance)


@part
def _heading(p: Parameters, c: Any, h: Head, m: Moment) -> tuple[float, float]:
    """Weigh the heading; return the variance of its innovation [rad2], and the innovation [rad]."""
    figures = record_at(c, 0, FIGURES)
    n = int(figures.considered)
    yaw_row(p, m.estimate, m.yaw_back, h.rows[0])
    yaw_shared(p, c, m.estimate, m.yaw_back, h)
    _weigh(m, n, 0, h)
    variance = _spread(n, 0, h) + figures.yaw_sd * figures.yaw_sd
    return variance, wrap(m.yaw - show_yaw(p, m.estimate, m.yaw_back))


@part
def take_yaw(p: Parameters, c: Any, h: Head, m: Moment, is_new: bool) -> None:
    """Correct with a heading unless it is an outlier."""
    figures = record_at(c, 0, FIGURES)
    n, noise = int(figures.considered), figures.yaw_sd * figures.yaw_sd
    variance, innovation = _heading(p, c, h, m)
    if m.fixed[HEADING] != 0.0:
        nis = innovation * innovation / variance
        m.nis = m.surprise[HEADING] = nis
        _weigh_up(m, 1, variance, nis)
        if nis > GATE_1:
            sd = math.sqrt(noise + figures.yaw_ou * figures.yaw_ou)
            apart = abs(wrap(innovation - m.off[2]))
            off, radius = abs(innovation), 2.0 * abs(p.yaw_gain) * p.radius_left
            what = _judged(m, HEADING, off, apart, sd, radius, figures.readmit_after)
            m.off[2] = innovation
            if what == OUTLIER:
                h.rejected += is_new
                return
            if what == CARRIED:
                forget(m, YAW, UNKNOWN_RAD2)
                m.fixed[HEADING], m.carried = 0.0, 1.0
                h.readmitted += is_new
            else:
                _doubt(m, nis)
                h.doubted += is_new
                variance, innovation = _heading(p, c, h, m)
    if m.fixed[HEADING] == 0.0:
        # the derivatives hold near the heading that is shown, not near one that means nothing
        for _ in range(N_NEARER):
            m.estimate[YAW] += wrap(m.yaw - show_yaw(p, m.estimate, m.yaw_back))
        variance, innovation = _heading(p, c, h, m)
    _correct(m, n, h, innovation, variance)
    _accept(m, HEADING)
    h.accepted += is_new


@part
def take_position(p: Parameters, c: Any, h: Head, m: Moment, is_new: bool) -> None:
    """Correct with a position unless it is an outlier."""
    figures = record_at(c, 0, FIGURES)
    n, noise = int(figures.considered), figures.position_sd * figures.position_sd
    aside = rolled(p, m)
    position_rows(p, m.estimate, aside, m.position_back, h.rows)
    position_shared(p, c, m, h)
    px, py = show_position(p, m.estimate, aside, m.position_back)
    ix, iy = m.position[0] - px, m.position[1] - py
    _weigh(m, n, 1, h)
    syy = _spread(n, 1, h) + noise
    _weigh(m, n, 0, h)
    sxx, sxy = _spread(n, 0, h) + noise, _spread(n, 1, h)
    spread = sxx * syy - sxy * sxy
    nis = (syy * ix * ix - 2.0 * sxy * ix * iy + sxx * iy * iy) / spread
    if m.fixed[PLACE] != 0.0:
        m.nis = m.surprise[PLACE] = 0.5 * nis
        _weigh_up(m, 2, spread, nis)
        if nis > GATE_2:
            sd = math.sqrt(noise + figures.position_ou * figures.position_ou)
            apart = math.hypot(ix - m.off[0], iy - m.off[1])
            off, radius = math.hypot(ix, iy), p.radius_left
            what = _judged(m, PLACE, off, apart, sd, radius, figures.readmit_after)
            m.off[0], m.off[1] = ix, iy
            if what == OUTLIER:
                h.rejected += is_new
                return
            if what == CARRIED:
                forget(m, X, UNKNOWN_M2)
                forget(m, Y, UNKNOWN_M2)
                m.carried = 1.0
                h.readmitted += is_new
            else:
                _doubt(m, 0.5 * nis)
                h.doubted += is_new
            _weigh(m, n, 0, h)
            sxx, sxy = _spread(n, 0, h) + noise, _spread(n, 1, h)
    _correct(m, n, h, ix, sxx)
    iy -= sxy / sxx * ix
    _weigh(m, n, 1, h)
    _correct(m, n, h, iy, _spread(n, 1, h) + noise)
    _accept(m, PLACE)
    h.accepted += is_new


@inlined
def begin(c: FilterFigures, m: Moment) -> None:
    """Begin with an unknown pose and, for the rest, the variances of the figures."""
    for i in range(N_ESTIMATED):
        m.estimate[i] = 0.0
        forget(m, i, 0.0)
    m.covariance[X, X] = m.covariance[Y, Y] = UNKNOWN_M2
    m.covariance[YAW, YAW] = UNKNOWN_RAD2
    m.covariance[BIAS, BIAS] = c.bias_sd * c.bias_sd
    m.covariance[OU_X, OU_X] = m.covariance[OU_Y, OU_Y] = c.position_ou * c.position_ou
    m.covariance[OU_YAW, OU_YAW] = c.yaw_ou * c.yaw_ou
    m.covariance[SLIP, SLIP] = c.slip_sd * c.slip_sd
    m.covariance[GAIN, GAIN] = c.gain_sd * c.gain_sd
    m.nis = math.nan

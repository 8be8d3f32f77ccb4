"""The clock of a controller, as the duties show it: they change only when it runs.

A replay keeps step with a controller only if its period is known to a millionth of a second: over a
log of a few seconds a larger error adds up to a whole tick, and looks as bad as any other period.
No search from a grid finds so narrow a minimum. The changes themselves do, by their spectrum.
"""

from typing import Final

import numpy as np
from scipy.signal import find_peaks

from hilserver.measured.channels import DUTIES
from hilserver.measured.data import MeasuredLog

CLOCK_GRID_S: Final = 1e-3
SHORTEST_CLOCK_S, LONGEST_CLOCK_S = 1.5e-3, 20e-3
ROWS_AT_MOST_S: Final = 5e-3  # slower rows show no clock of a controller
OVERSAMPLED: Final = 8  # times the resolution of the spectrum
CLOCKS: Final = 12  # peaks that are tried
LARGEST_SHARE: Final = 0.995  # of the changes; a few larger ones would hide the clock
AROUND: Final = 15  # changes whose mean is the usual size


def periods_shown(log: MeasuredLog) -> list[float]:
    """Return the periods [s] that a controller may have, the clearest first.

    Rows come at a rate of their own, so each period has images; only a replay tells them apart.
    """
    stretches = [
        log[name].of(span)
        for name in DUTIES
        if name in log
        for span in range(len(log.spans))
    ]
    stretches = [(t_s, duty) for t_s, duty in stretches if len(t_s) > AROUND]
    if not stretches:
        return []
    steps_s = np.concatenate([np.diff(t_s) for t_s, _ in stretches])
    if np.median(steps_s) > ROWS_AT_MOST_S:
        return []

    longest_s = max(float(np.ptp(t_s)) for t_s, _ in stretches)
    padded = 2 ** int(np.ceil(np.log2(OVERSAMPLED * longest_s / CLOCK_GRID_S + 1.0)))
    hz = np.fft.rfftfreq(padded, CLOCK_GRID_S)

    # each wheel and span has a phase of its own: powers are added, not amplitudes
    power = np.zeros(len(hz))
    for t_s, duty in stretches:
        change = np.abs(np.diff(duty))
        change = np.minimum(change, np.quantile(change, LARGEST_SHARE))
        usual = np.convolve(change, np.full(AROUND, 1.0 / AROUND), "same")
        tick = np.rint((t_s[1:] - t_s[0]) / CLOCK_GRID_S).astype(int)
        course = np.bincount(tick, change - usual[: len(change)], padded)
        power += np.abs(np.fft.rfft(course[:padded])) ** 2

    low, high = np.searchsorted(hz, [1.0 / LONGEST_CLOCK_S, 1.0 / SHORTEST_CLOCK_S])
    power, hz = power[low:high], hz[low:high]
    found, _ = find_peaks(power, distance=4 * OVERSAMPLED)
    found = found[np.argsort(-power[found])][:CLOCKS]

    # the top of a parabola through a peak and its neighbours
    left, top, right = power[found - 1], power[found], power[found + 1]
    shift = 0.5 * (left - right) / (left - 2.0 * top + right)
    return [float(1.0 / one) for one in hz[found] + shift * (hz[1] - hz[0])]

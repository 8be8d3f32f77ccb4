"""Every number that decides how a file is read and cut into segments: value, unit, meaning.

Those that decide a verdict are in `hilserver.diagnosis.thresholds`.
"""

from typing import Final

# How a file is read
ABSURD: Final = 1e12  # larger numbers are no measurement in any unit
LATEST_S: Final = 1e11  # s: later stamps are invalid and too coarse (since 1970: 1.8e9)
SLOWEST_ROWS_S: Final = 5.0  # s between rows: slower rows show nothing of a drive
SHORTEST_LOG_S: Final = 1.0  # s
LONGEST_LOG_S: Final = 28_800.0  # s
FEWEST_VALUES: Final = 20  # different values; fewer do not show the rate of new ones
ENOUGH_ROWS: Final = (
    20_000  # simulated wheels have no noise that more rows would average
)
UNIT_NORM: Final = 0.1  # a quaternion whose norm is further from 1 is no orientation

# Where a segment ends
PAUSE_S: Final = 3.0  # s: the replay bridges shorter gaps, with the set-points; ...
USUAL_STEPS: Final = (
    20.0  # ... and in slow recordings this many usual steps between samples
)
JUMP_S: Final = (
    1e5  # s: not a pause but a clock that was set; time continues from there
)
LONGEST_SEGMENT_S: Final = (
    30.0  # s: each has a free pose, yet is long enough for slow effects
)
SHORTEST_SEGMENT_S: Final = 0.5  # s

# The resolution of a channel
FEWEST_READINGS: Final = 100  # fewer have no resolution
STEP_EXACT: Final = (
    0.02  # share of a step by which readings may miss multiples: files round
)
STEP_OFTEN: Final = (
    0.5  # different values per sample; with more, the step is far below the noise
)

# Clocks: how late one source is behind another
CLOCK_LEAST_S: Final = 0.06  # s: a smaller offset is a latency
CLOCK_SLOWEST_S: Final = (
    0.25  # s between samples of the wheels; slower ones hide any offset
)
CLOCK_FEWEST_CHUNKS: Final = 6  # stretches; fewer show no offset
CLOCK_SURE_SD: Final = 6.0  # deviations beyond which a clock is off

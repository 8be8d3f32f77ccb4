"""Every number that decides how a file is read and cut into segments: value, unit, meaning.

Those that decide a verdict are in `hilserver.diagnosis.thresholds`.
"""

from typing import Final

# How a file is read
ABSURD: Final = 1e12  # a number beyond is no measurement in any unit
LATEST_S: Final = 1e11  # s: later stamps are none, and too coarse (seconds since 1970 are 1.8e9)
SLOWEST_ROWS_S: Final = 5.0  # s between rows: nothing that a drive does is seen so
SHORTEST_LOG_S: Final = 1.0  # s
LONGEST_LOG_S: Final = 28_800.0  # s
FEWEST_VALUES: Final = 20  # different ones; fewer do not show how often a new one comes
ENOUGH_ROWS: Final = 20_000  # the simulation's wheels show no noise that more rows would average
UNIT_NORM: Final = 0.1  # a quaternion whose norm is further from 1 is no orientation

# Where a segment ends
PAUSE_S: Final = 3.0  # s: the replay bridges shorter gaps, by the set-points; ...
USUAL_STEPS: Final = 20.0  # ... and in slow recordings so many usual steps between two samples
JUMP_S: Final = 1e5  # s: no pause but a clock that was set; what follows counts on from there
LONGEST_SEGMENT_S: Final = 30.0  # s: each has a free pose, yet is long enough for slow effects
SHORTEST_SEGMENT_S: Final = 0.5  # s

# The resolution of a channel
FEWEST_READINGS: Final = 100  # fewer have no resolution
STEP_EXACT: Final = 0.02  # share of a step beside whole multiples of it: files round, too
STEP_OFTEN: Final = 0.5  # different values by samples; with more the step is far below the noise

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
# simulated wheels have no noise that more rows would average
ENOUGH_ROWS: Final = 20_000
TURNING_RPM: Final = (
    2.0  # rpm: no noise of a wheel at rest is that large half of the time
)
UNIT_NORM: Final = 0.1  # a quaternion whose norm is further from 1 is no orientation

# Fixes of satellites
FARTHEST_FIX_M: Final = 50_000.0  # m from the first one; a robot of today drives less
# times the stated standard deviation that is usual in the log; worse ones are left out
POOR_FIX: Final = 3.0

TO_SD: Final = 1.4826  # from the median size of normal noise to its deviation

# The pose of a map: SLAM, AMCL, scan matching
FEWEST_STEPS: Final = 100  # of a pose; fewer do not show whose noise they have
# share of the wheels' noise below which steps of a pose are made of the wheels
COPIED_NOISE: Final = 0.5
LATEST_ROWS: Final = 3.0  # by which odometry may be late
CORRECTION_LEAST_M: Final = 0.05  # m; smaller jumps are noise
CORRECTION_LEAST_RAD: Final = 0.03  # rad
CORRECTION_SD: Final = 8.0  # deviations of a usual step
CORRECTIONS_APART_S: Final = 5.0  # s in the mean; more frequent ones are noise

# What a user may have meant in another unit
COARSE_MARK_M: Final = 0.5  # m; a tape is better
ODD_TIMES: Final = (
    10.0  # of track and wheelbase to the wheel radius: two to eight are usual
)

# Where a segment ends
PAUSE_S: Final = 3.0  # s: the replay bridges shorter gaps, with the set-points; ...
# ... and in slow recordings this many usual steps between samples
USUAL_STEPS: Final = 20.0
# s: not a pause but a clock that was set; time continues from there
JUMP_S: Final = 1e5
# s: each has a free pose, yet is long enough for slow effects
LONGEST_SEGMENT_S: Final = 30.0
SHORTEST_SEGMENT_S: Final = 0.5  # s

# The resolution of a channel
FEWEST_READINGS: Final = 100  # fewer have no resolution
# share of a step by which readings may miss multiples: files round
STEP_EXACT: Final = 0.02
# different values per sample; with more, the step is far below the noise
STEP_OFTEN: Final = 0.5

# Clocks: how late one source is behind another
CLOCK_LEAST_S: Final = 0.06  # s: a smaller offset is a latency
# s between samples of the wheels; slower ones hide any offset
CLOCK_SLOWEST_S: Final = 0.25
CLOCK_FEWEST_CHUNKS: Final = 6  # stretches; fewer show no offset
CLOCK_SURE_SD: Final = 6.0  # deviations beyond which a clock is off
# successive messages of a topic that are earlier than one before them: a recorder's threads
# exchange one or two, a clock that was set back does so for as long as it was set back
SET_BACK_MESSAGES: Final = 5

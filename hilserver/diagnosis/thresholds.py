"""Every number that decides a verdict: its value, unit, meaning and source.

Unless a line names another source, the number was chosen and is protected by the campaign: with it
``hilserver bench diagnose`` finds nothing on logs without an effect, and names hidden causes at
their reference sizes. Numbers of a method, such as the width of a grid, stay where they are used,
as do starting points and ranges of the causes (`catalogue`); those that decide how a file is read
are in `hilserver.measured.thresholds`.
"""

from typing import Final

# Used in several rooms: counts
FEWEST_CHANGES: Final = 20  # changes of a channel; fewer show no rate and no copy
# straight pieces, readings at a limit, seconds; fewer may be chance
FEWEST_PIECES: Final = 15
FEWEST_SAMPLES: Final = 100  # that a statement about single values rests on
FEWEST_BLOCKS: Final = 4  # blocks or free runs; fewer do not show their spread
FEWEST_EVENTS: Final = 3  # gaps, bursts, late steps; fewer may be chance

# Used in several rooms: shares
NEGLIGIBLE: Final = 0.01  # of a value or a whole; smaller deviations count as correct
SAME: Final = 0.02  # by which equal slopes or steps may differ
# of rows or durations that may break the rule even in sound logs
IRREGULAR: Final = 0.05
LEFT_SHARE: Final = 0.1  # of a deviance; a cause that leaves more has not explained it
# of the distance or turn by the wheels; below, the robot has not moved
STANDS: Final = 0.15
HALF: Final = 0.5  # more often than not
# of the changes that follow a rule; of a limit: lower readings are free
NEARLY_ALL: Final = 0.9
# of what causes explain, or of a value, lost by their inexact form
INEXACT: Final = 0.005

# Used in several rooms: sizes
FAR_SD: Final = 5.0  # deviations beyond which a value is not plain noise, or impossible
OUTLIER_SD: Final = 6.0  # deviations beyond which a position is left out
BLOCK_S: Final = 1.0  # s: the shortest stretch that is drawn or flipped as one
# s: longest delay of a set-point, and longest time between messages
COMMAND_SLOWEST_S: Final = 0.5
SLOWEST_TURN_RAD_S: Final = 0.03  # rad/s: slower turns are noise of the wheel speeds
TURNS_RAD_S: Final = 0.1  # rad/s from which a robot turns, and is not blocked
LARGE_STEP_RPM: Final = 4.0  # rpm: a larger change of a wheel's speed is clear
# real effects change a channel, or the top speed, by less than this factor
UNITY: Final = 4.0

# Data checks: rounded speeds inside the robot (comb of their spectrum)
COMB_FEWEST: Final = 500  # samples; fewer have no spectrum
COMB_CLEAR: Final = 0.05  # smallest coefficient of a rounded quantity
COMB_TIMES: Final = 5.0  # by which it exceeds the coefficient of a smooth quantity
# share of a step to which its line is known, in short logs with noise, too
COMB_EXACT: Final = 0.002

# Data checks: values copied, held, interpolated, repeated, missing, limited
# rpm: smaller changes of a set-point are not used
COPIED_LEAST_CHANGE_RPM: Final = 0.02
HELD_SLOWEST_HZ: Final = 0.9  # Hz: a GPS has one sample per second; slower means stuck
HELD_QUANTA: Final = 4.0  # steps of the resolution; a change of more is real
# repeated rows; a source that repeats more has a slower clock
SLOWER_CLOCK: Final = 0.4
# share of a period by which runs may miss whole ones, besides half a row
HELD_OFF_CLOCK: Final = 0.05
HELD_LONGEST_ROW: Final = 0.4  # of a period; longer rows do not show where one ends
# in a run; over more, the error of the period adds up to a good part of one
HELD_MOST_PERIODS: Final = 6.5
HELD_SHARE: Final = 0.8  # share of stretches that last two rows or more
HELD_SPREAD: Final = 3.0  # longest usual stretch over the shortest in even sampling
SHORTEST_BURST: Final = 4  # rows of one value while the others moved
MISSING_IN_BURSTS: Final = 0.02  # share of rows in gaps of four or more
ZERO_LEAST_M: Final = 0.3  # m beyond what wheels can drive: more than a tag's own jumps
# s: slower channels have no clock that a sample could miss
MISSING_SLOWEST_S: Final = 0.22
# misfit of straight lines over that of stairs, if interpolated
SPARSE_BETTER: Final = 0.7
# share of the set-points that last as long as the usual one
SPARSE_USUAL_SHARE: Final = 0.2
# that a set-point lasts; longer ones are pauses, which say nothing about the period
SPARSE_MOST_PERIODS: Final = 12.0
LIMITED_BEYOND: Final = 0.05  # share of a limit by which the turn exceeds it on average

# Data checks: wheels mapped as set-points and as speeds from one topic
# s: turns are compared over this time: longer than a loop needs (70 ms), so that it is still on its
# way, and short enough that the slow error of a heading hardly changes
ONE_TOPIC_TURN_S: Final = 0.1
# s: a piece counts as one; a tag's yaw error is forgotten in 2 s
ONE_TOPIC_PIECE_S: Final = 3.0
# share of the way from speeds (0) to set-points (1); below, neither fits: a source comes earlier
# than any drive's delay explains
ONE_TOPIC_LEAST: Final = -1.5
# the same share; above, neither fits: a source comes too late
ONE_TOPIC_MOST: Final = 2.5

# Data checks: sign, unit, frame, rest
SIGN_SURE: Final = 0.7  # least correlation at which a sign is believed
SIGN_AHEAD: Final = 0.1  # largest sideways share at which the course counts as heading
# least concentration of heading minus course that is an angle of its own
AXIS_SURE: Final = 0.9
# rad between heading and course that needs no other frame
LARGEST_SKEW_RAD: Final = 0.3
UNIT_ALIKE: Final = 0.8  # least correlation at which a factor is believed
UNIT_CLOSE: Final = 1.6  # factor by which a ratio may differ from that of two units
# the same between a wheel and its set-point or its neighbour
UNIT_CLOSE_WHEEL: Final = 1.15
# share of the misfit that axes of different units may leave
UNIT_OTHER_AXIS: Final = 0.6
# m: distance by the wheels in 2 s; more than a tag's noise
BLOCKED_LEAST_WAY_M: Final = 0.3
BLOCKED_FEWEST: Final = 2  # windows in a row
STILL_RPM: Final = 1.0  # rpm: below, a wheel is at rest except for its noise
# share of steps against the previous one, in a channel with noise
ALTERNATING: Final = 0.35

# Wheel speeds made of counts
MOST_COUNTS: Final = 100  # usual between two samples; what more miss is negligible
FEWEST_COUNTS: Final = 5  # different ones; fewer are a few speeds rather than counts
# autocorrelation at one sample, -0.5 if the next sample has what one misses, -0.2 if none has
TELESCOPES: Final = -0.35

# Noise of a channel
# s: what is correlated for longer is misfit; segments all shorter show no correlation
NOISE_TAU_MAX_S: Final = 5.0
# s: the same for the pose of satellites and maps, whose errors last for minutes
LASTING_TAU_MAX_S: Final = 300.0
NOISE_WINDOW_S: Final = 12.0  # s: longest stretch with one level and slope
# share; more is not a tail: the gate would leave out a misfit
NOISE_GATED_MAX: Final = 0.2
NOISE_NATS: Final = 3.0  # log likelihood that each further noise parameter must gain
SHORT_DOF: Final = 4.0  # degrees of freedom of the noise of short segments
OUTLIERS_IN_A_ROW: Final = 4  # positions; a longer stretch of outliers is an effect
NOISE_WHITE: Final = 0.05  # largest first autocorrelations that still count as white
# share of far samples above which a channel is not plain noise
NOISE_FEW_FAR: Final = 0.002
# share of a step by which the quantity may move between samples
READING_CALM: Final = 0.1

# Screen of all causes
# family-wise; with all other levels below 1 % (specification)
SCREEN_LEVEL: Final = 0.002
# variance of whitened residuals beyond any noise, even in few blocks
GROSS: Final = 1.5

# What a cause must save
LEAST_GAIN: Final = 10.0  # deviance that a cause must save; no block counts for more
TIE: Final = 4.0  # deviance, per parameter, within which two causes tie

# Selection
SELECTION_MOST_CAUSES: Final = 6  # rounds
SELECTION_LEAST_SAVED: Final = 8.0  # deviance that a cause must save on held-out blocks
# prior deviations that no machine exceeds (specification)
SELECTION_PLAUSIBLE_SD: Final = 4.0

# share of the best trial's gain from which another shape is worth a search
PROMISING: Final = 0.5
# variance of whitened residuals that is the noise model's own error
NOISE_ERROR: Final = 1.1
# last stride of the search for a period, as a share of it: over five minutes it adds up to 6 ms
CLOCK_STRIDE: Final = 2e-5
# times the loss of an ordinary block: where a robot nearly missed an edge, none counts for more
FAR_OFF: Final = 3.0
# standard errors over the blocks beyond which a held-out error has clearly grown (specification)
CLEARLY_SE: Final = 2.0

# Rivals and superfluous causes
RIVAL_COSINE: Final = 0.6  # |cos| from which a cause is tried in place of another
GROUP_COSINE: Final = 0.95  # |cos| from which two causes form a group (specification)
# standard deviations, over the blocks, that are clearly better (1 %)
RIVAL_CLEAR_Z: Final = 2.33
# rotation gain; smaller changes are dimensions rather than tyres
SCRUBBING_MUCH: Final = -0.15
SCRUBBING_LATE_S: Final = 0.03  # s: longest latency that tyres make
# s: half the shortest one, of tyres that slide at 0.1 m/s with a coefficient of friction of 0.7
SCRUBBING_SOON_S: Final = 0.0005
# s: a step counts as late from here, if known to a quarter of it
LOST_LATE_S: Final = 0.008
# s: from here, a step that waited for the next message has long arrived
LOST_LONG_S: Final = 0.1
# s after a step that show its response: twice what the loop needs (70 ms)
LOST_SEEN_S: Final = 0.15

# What causes leave: unknown structure, anchors, changes along the log
REST_LEVEL: Final = 0.001  # family-wise error of each test of what causes leave
# deviance that it must save, of structure on held-out blocks, too
REST_LEAST_GAIN: Final = 40.0
# deviance that a change or an anchor in a cause's place must save
INSTEAD_LEAST_GAIN: Final = 20.0
# of the width of the driven area, by which ranging anchors are assumed to stand outside of it:
# along walls that a robot keeps away from
ANCHORS_OUTSIDE: Final = 0.1
LEAST_USEFUL: Final = 0.001  # share of the samples' variance; less is useless
DOMINANCE: Final = 4.0  # times what structure explains; less leaves a cause in doubt

# What predicts without a name (specification)
EFFECTIVE_BLOCKS: Final = 8  # fewer show no gain
# of the paired test of its gain over the blocks, one-sided
EFFECTIVE_LEVEL: Final = 0.01
# p of Cochran's Q below which its size differs along the log; then, of the prediction interval of
# one more part of the log, which must not hold zero
ONE_SIZE: Final = 0.05
# parts of the log whose sizes are compared: enough to see a change of half a log, and each of
# several blocks, without which the scatter inside a part is not known
STRETCHES: Final = 8

# Drift and comparison
COMPARE_LEVEL: Final = 0.01  # family-wise error (specification)
# whitened size of a cause's least effect; a group of logs with less does not show the cause
UNSEEN_SD: Final = 1e-3
# share of a difference by which it may exceed what is possible
COMPARE_INEXACT: Final = 0.2

# Outliers of a position
LEAST_OUTLIERS: Final = 0.004  # share of the positions; fewer have no name

# Intervals and sizes
# |correlation| of two estimates: from a half on, one cause takes over a good part of the other
PARTNER_CORRELATION: Final = 0.5
# deviations above the critical value: about 83 % exceed it
DETECTABLE_POWER_SD: Final = 0.95
# further deviations that held-out blocks require (`bench diagnose --class size`)
DETECTABLE_SELECTION_SD: Final = 1.25
# times the least size: at exactly that, half of the fits fall below
DETECTABLE_LEAST_TIMES: Final = 1.3
HOPELESS: Final = 12.0  # times its reference size; from there a cause is not judged
# times the hopeless size: no machine has a hundred times the reference, so the number would tell
# nobody anything
BEYOND: Final = 10.0
# share of the shapes of a cause, such as edges of a floor, that show at the size that is stated: a
# log does not tell which shape it would have been
DETECTABLE_SHAPES: Final = 0.8

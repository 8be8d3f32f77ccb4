"""Every number that decides a verdict: its value, unit, meaning and source.

Where a line names no other source, the number was chosen and is held by the campaign: with it
``hilserver bench diagnose`` finds nothing on logs without an effect and names at their reference
sizes the causes that are hidden. Numbers of a method, such as the width of a grid, stay where they
are used, as do starting points and ranges of the causes (`catalogue`); those that decide how a file
is read are in `hilserver.measured.thresholds`.
"""

from typing import Final

# Data checks: clocks
CLOCK_LARGEST_S: Final = 1.0  # s: offsets are looked for up to here
CLOCK_LEAST_S: Final = 0.06  # s: a smaller offset is a latency at most, and no fault
CLOCK_SIGMAS: Final = 6.0  # deviations of its estimate that an offset or drift must exceed
CLOCK_CHUNK_S: Final = 30.0  # s: stretch of the log with an offset of its own
CLOCK_FEWEST_CHUNKS: Final = 6  # of fewer stretches none is reported
CLOCK_BASELINE_S: Final = 1.0  # s: way and turn are compared over so long
CLOCK_ALIKE_S: Final = 0.03  # s: offsets of a source's channels that count as one
CLOCK_SLOWEST_WHEELS_S: Final = 0.06  # s: between slower samples the wheels do too much

# Data checks: rounded speeds inside the robot (comb of their spectrum)
COMB_MOST: Final = 8  # lines of the spectrum that are looked at
COMB_FEWEST: Final = 500  # samples; fewer have no spectrum
COMB_NOTICEABLE: Final = 0.02  # coefficient of a line below which none is a candidate
COMB_CLEAR: Final = 0.05  # least coefficient of a rounded quantity
COMB_TIMES: Final = 5.0  # by which it exceeds the coefficient of a smooth quantity
COMB_LEAST_STEP_RPM: Final = 0.2  # rpm: finer steps are below the noise
COMB_LARGEST_STEP_RPM: Final = 6.0  # rpm
COMB_FEW: Final = 100  # samples on the way between speeds that say anything
COMB_ALIKE: Final = 0.5  # share of its coefficient that a step must have on the way between speeds

# Data checks: values copied, held, interpolated, repeated, missing, limited
COPIED_LATEST_S: Final = 0.5  # s: a set-point shown later than this is no copy
COPIED_LEAST_CHANGE_RPM: Final = 0.02  # rpm: smaller changes of a set-point tell nothing
COPIED_EXACT: Final = 0.01  # share of a change by which a copy may miss it
COPIED_FEWEST: Final = 20  # of a set-point
COPIED_ALIKE: Final = 0.98  # share of the samples at changes that have to agree
HELD_FEWEST_RUNS: Final = 20  # stretches of equal values
HELD_SLOWEST_HZ: Final = 1.5  # Hz: slower is no held sample but a stuck one
HELD_QUANTA: Final = 4.0  # steps of the resolution by which a change is real
HELD_SHARE: Final = 0.8  # of the stretches that last two rows and longer
HELD_SPREAD: Final = 3.0  # longest usual stretch by the shortest: a sampling is even
RAMP_SLOWEST_S: Final = 0.5  # s: time between the ends of a straight piece
RAMP_FEWEST_PIECES: Final = 15  # straight pieces of one length
RAMP_ON_THE_CLOCK: Final = 0.9  # share of the bends that lie on one clock
RAMP_SAME_SLOPE: Final = 0.02  # share by which the slope of a straight piece may change
SHORTEST_BURST: Final = 4  # rows of one value where the others moved
FEWEST_BURSTS: Final = 3  # fewer are chance
MISSING_ROWS: Final = 0.05  # share; single rows go missing in sound logs, too
MISSING_IN_BURSTS: Final = 0.02  # share of rows in gaps of four and more
MISSING_SLOWEST_S: Final = 0.22  # s: slower channels keep no clock that a sample could miss
SPARSE_FEWEST_ROWS: Final = 3  # between faster set-points the stamps of rows are too coarse
SPARSE_BETTER: Final = 0.7  # misfit of straight lines by that of stairs: interpolated
SPARSE_FEWEST_RUNS: Final = 20  # set-points; fewer have no usual duration
SPARSE_USUAL_SHARE: Final = 0.2  # of the set-points that last as long as the usual one
SPARSE_SHORTER_SHARE: Final = 0.05  # of the set-points that may be shorter
SPARSE_MULTIPLE: Final = 12.0  # periods; longer durations tell nothing of it
LIMITED_FEWEST: Final = 10  # readings at the limit; fewer bend nothing
LIMITED_INSIDE: Final = 0.9  # share of the limit up to which readings follow the turn
LIMITED_BEYOND: Final = 0.05  # share of the limit by which the turn exceeds it on average
STUCK_FEWEST: Final = 100  # samples of one value
STUCK_MOVED_RPM: Final = 5.0  # rpm by which a wheel moved meanwhile

# Data checks: sign, unit, frame, rest
SIGN_SURE: Final = 0.7  # least correlation at which a sign is believed
SIGN_AHEAD: Final = 0.1  # largest share of a way to the side on which the course is the heading
SIGN_SLOWEST_RAD_S: Final = 0.03  # rad/s: slower turns show no direction
SIGN_FEWEST_WINDOWS: Final = 15  # of a second each
LARGEST_SKEW_RAD: Final = 0.3  # rad between heading and course that is no other frame
UNITY: Final = 4.0  # a real effect changes a channel by less than this factor
UNIT_ALIKE: Final = 0.8  # least correlation at which a factor is believed
UNIT_CLOSE: Final = 1.6  # factor by which a ratio may miss that of two units
FRAME_TURNED_RAD_S: Final = 0.1  # rad/s that the wheels must have asked for
FRAME_STANDS: Final = 0.05  # share of it that is no turn at all: the robot is on a frame
FRAME_MOVED_RAD_S: Final = 0.02  # rad/s: more than the noise of wheel speeds
BLOCKED_WINDOW_S: Final = 2.0  # s: way and place are compared over so long
BLOCKED_LEAST_WAY_M: Final = 0.3  # m that the wheels must ask for in it; more than a tag's noise
BLOCKED_STANDS: Final = 0.15  # share of that way that is no way at all
BLOCKED_TURNS_RAD_S: Final = 0.1  # rad/s: a robot that turns so fast is not blocked
BLOCKED_FEWEST: Final = 2  # windows in a row
BLOCKED_MOST: Final = 0.5  # share of the driven windows; more is a frame, not a spell
STILL_RPM: Final = 1.0  # rpm: a wheel below is at rest but for its noise
ALTERNATING: Final = 0.35  # share of steps against the one before, in a channel with noise
TOO_FAST_ROUNDED: Final = 1.01  # times max_rpm that a rounded set-point may show
WRAPPED_FASTEST: Final = 4.0  # times max_rpm that no wheel turns

# Noise of a channel
NOISE_TAU_MAX_S: Final = 5.0  # s: what is correlated for longer is a misfit
NOISE_WINDOW_S: Final = 12.0  # s: longest stretch that shares a level and a slope
NOISE_GATE_SD: Final = 5.0  # deviations beyond which a sample is an outlier
NOISE_GATED_MAX: Final = 0.2  # share; more is no tail: the gate would leave out a misfit
# likelihood that an Ornstein-Uhlenbeck part's two parameters must earn
NOISE_COLOURED_NATS: Final = 6.0
NOISE_TAILED_NATS: Final = 3.0  # likelihood that heavy tails must earn
SHORT_DOF: Final = 4.0  # degrees of freedom of the noise of short segments
NOISE_SMALLEST_DOF: Final = 2.1  # degrees of freedom; at 2 there is no variance
NOISE_SHORT_S: Final = 6.0  # s: where all segments are shorter the noise counts as white
OUTLIER_SD: Final = 6.0  # deviations: positions beyond take no part in fits, ...
OUTLIERS_IN_A_ROW: Final = 4  # ... if no more follow each other: a longer stretch is an effect
OUTLIER_AROUND_S: Final = 1.05  # s: width of the median that a spike leaves
NOISE_WHITE: Final = 0.05  # largest first autocorrelations of what is taken for white at once
NOISE_FAR_SD: Final = 5.0  # robust deviations; ...
NOISE_FEW_FAR: Final = 0.002  # ... share of samples beyond with which a channel is no plain noise
READING_LEAST_NOISE: Final = 0.02  # noise by the step of the readings: below, rounding hides it
READING_MOST_NOISE: Final = 50.0  # likewise: above, nothing shows the rounding
READING_CALM: Final = 0.1  # share of a step that the quantity may move between two samples
READING_FEWEST_CALM: Final = 50  # pairs of such samples that tell the noise
READING_LATER_S: Final = 0.1  # s: rounding that lasts is still alike
READING_NEAR: Final = 0.99  # share of a limit beyond which readings show less than the noise
READING_LEAST_SHARE: Final = 0.01  # of the variance that lasts; less is white
# share by which a step may differ from that of the values' spectrum
READING_SAME_STEP: Final = 0.02
RIPPLE_ANSWERED: Final = 0.5  # share of a coarse loop's ripple that the measured duty must show
READING_COARSE_SHARE: Final = 0.002  # half the interval of a step from the spectrum, by the step

# Screen of all causes
FLIPS: Final = 4999  # draws of the blocks' signs; p is no smaller than one by so many
SCREEN_LEVEL: Final = 0.002  # family-wise; with all other levels below 1 % (specification)
GROSS: Final = 1.5  # variance of whitened residuals that is no noise, whatever few blocks say
LEAST_FREEDOM: Final = 0.5  # degrees of freedom of what shows in a single block
FOLD_RUNS: Final = 6  # from so many runs, or else segments, on they are held out whole

# Selection
SELECTION_MOST_CAUSES: Final = 6  # rounds
SELECTION_TRIALS: Final = 8  # candidates of a round that are fitted: the largest linear gains, ...
SELECTION_MOST_FITTED: Final = 3  # ... and so many causes in full, each with all its shapes
SELECTION_MOST_SHAPES: Final = 4  # of a cause that are fitted where much is left to explain
# share of a deviance that an effect with a cosine of 0.95 saves, too
SELECTION_NEARLY_ALL: Final = 0.9
SELECTION_LEAST_LINEAR: Final = 9.0  # deviance that a cause must save, linearly
SELECTION_LEAST_GAIN: Final = 10.0  # deviance that a cause must save, fitted
SELECTION_LEAST_SAVED: Final = 8.0  # deviance that a cause must save on held-out blocks
SELECTION_PLAUSIBLE_SD: Final = 4.0  # prior deviations that no machine exceeds (specification)
TIE: Final = 4.0  # deviance, per parameter, within which two causes explain alike
SHAPED: Final = 0.005  # share of its gain that a shape costs: it bends to what is left
# share of the best trial's gain from which another shape is worth a search
SHAPE_PROMISING: Final = 0.5
SHAPE_NEARLY: Final = 1.1  # variance of whitened residuals that is the noise model's own error

# Rivals and what falls away
RIVAL_COSINE: Final = 0.6  # |cos| from which a cause is tried in another's place
GROUP_COSINE: Final = 0.95  # |cos| from which two causes are a group (specification)
RIVAL_CLEAR_Z: Final = 2.33  # deviations over the blocks by which one is clearly better (1 %)
RIVAL_ENOUGH: Final = 10.0  # deviance up to which a single block counts: few would hold it all
RIVAL_MOST_SWAPS: Final = 4  # exchanges in a row
SETTLING_LEAST_GAIN: Final = 10.0  # deviance that a cause must save beside all others
SETTLING_LEFT_SHARE: Final = 0.1  # of all deviance: what leaves more has not explained the drive
SCRUBBING_MUCH: Final = -0.15  # rotation gain; less is dimensions rather than tyres
SCRUBBING_LATE_S: Final = 0.03  # s: longest latency that tyres make
SCRUBBING_SMALLEST_RATIO: Final = 0.2  # friction across by friction along the wheels
SCRUBBING_LARGEST_RATIO: Final = 20.0  # likewise
LOST_LARGE_STEP_RPM: Final = 4.0  # rpm: steps of a set-point whose answer is looked for
LOST_RESPONSE_S: Final = 0.15  # s in which the wheel answers
LOST_LATE_S: Final = 0.008  # s from which a step counts as late; ...
LOST_SHARP_S: Final = 0.002  # ... s: if its delay is known so well
LOST_SHARE: Final = 0.01  # of the steps that must be late

# Unknown structure
STRUCTURE_LEVEL: Final = 0.001  # family-wise error
STRUCTURE_LEAST_T: Final = 3.0  # below, no p is small enough
STRUCTURE_LEAST_GAIN: Final = 40.0  # deviance that a family must save, also on held-out blocks
LEAST_USEFUL: Final = 0.001  # of the samples' variance: less is of no use to anybody
# of fewer the noise is not known well enough to call a misfit gross
STRUCTURE_FEWEST_BLOCKS: Final = 4
INEXACT: Final = 0.005  # share of what the causes explain that their own form may leave
# deviance by which a column must beat a cause to put it in doubt
STRUCTURE_LEAST_BETTER: Final = 50.0
SUBSTITUTE: Final = 0.5  # |cos| of a column that could stand in a cause's place
DOMINANCE: Final = 4.0  # times what structure explains, for a cause to stay beside it
ANCHOR_LEVEL: Final = 0.0005  # family-wise error over the anchors
ANCHOR_LEAST_T: Final = 3.4  # below, no p is small enough
ANCHOR_LEAST_GAIN: Final = 20.0  # deviance that an anchor must save

# Drift and comparison
DRIFT_LEVEL: Final = 0.001  # family-wise error
DRIFT_LEAST_GAIN: Final = 40.0  # deviance that a change along the log must save
DRIFT_LEAST_BETTER: Final = 20.0  # deviance by which a change must beat a cause to take its place
DRIFT_LEAST_BESIDE: Final = 0.1  # share of a cause's gain that must be left beside another's change
DRIFT_RIVALS: Final = 3  # causes whose change is tried in full
DRIFT_PARTS: Final = 4  # of the log, each with a size and a trend of its own
DRIFT_FEWEST_BLOCKS: Final = 2 * DRIFT_PARTS  # of fewer nobody can tell a change from noise
COMPARE_LEVEL: Final = 0.01  # family-wise error (specification)
BEYOND_SD: Final = 5.0  # deviations by which a linear estimate may lie beyond what is possible; ...
COMPARE_INEXACT: Final = 0.2  # ... and share of the difference

# Intervals and sizes
MODEL_SHARE: Final = 0.005  # of a value that the plant's own steps of time may cost
DETECTABLE_POWER_SD: Final = 0.95  # deviations above the critical value: about 83 % exceed it
# deviations that held-out blocks ask besides (`bench diagnose --class size`)
DETECTABLE_SELECTION_SD: Final = 1.25
DETECTABLE_LEAST_GAIN: Final = 10.0  # deviance, as in the selection
# times the least size: at just that half of the fits fall below
DETECTABLE_LEAST_TIMES: Final = 1.3
HOPELESS: Final = 12.0  # times its reference size from which a cause is not judged
GAIN_FEWEST_RUNS: Final = 4  # held-out stretches; of fewer a gain has no interval

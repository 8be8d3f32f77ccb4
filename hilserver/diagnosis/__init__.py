"""Given measured data: what the simulation gets wrong, why, and what the extended model gains.

A room for each part of the way, the lowest first; none imports those that follow. `pipeline` runs
files through all of them, `engine` logs: one set, several groups, or two sets to compare. The
daemon imports nothing from here.

`catalogue`
    Causes as data: parameters, bounds, what can stand for what.
`schema`
    The findings of a diagnosis, and their evidence.
`checks`
    Faults of the recording, corrected before anything else is judged.
`replay`
    The daemon's plant under the measured inputs: drive and pose.
`noise`
    Of each channel: model, fit, whitening.
`regression`
    The residual as a whitened problem: columns, scores, fits, intervals.
`decide`
    Which causes: selection, rivals, drift, structure that has no name.
`findings`
    Values, words, gain, smallest sizes, the patch.
`plan`
    What a manoeuvre would show, before it is driven.
`report`
    The page.
`compare`
    Whether one set of recordings differs from another.
`groups`
    What groups of logs share, and what is each one's own.
"""

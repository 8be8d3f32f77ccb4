"""Given measured data: what the simulation gets wrong, why, and what the extended model gains.

One room per step, the lowest first; none imports from those that follow. `pipeline` takes files
through all of them. `engine` takes logs: one set, several groups, or two sets to compare. The
daemon imports nothing from here.

`catalogue`
    Causes as data: parameters, bounds, which may stand for which.
`schema`
    The findings of a diagnosis, and their evidence.
`checks`
    Faults of the recording, corrected before anything else is judged.
`replay`
    The daemon's plant under the measured inputs: drive and pose.
`noise`
    The noise of each channel: model, fit, whitening.
`regression`
    The residual as a whitened problem: columns, scores, fits, intervals.
`decide`
    Which causes explain the data: selection, rivals, drift, structure without a name.
`findings`
    Values, words, gain, detectable sizes, the patch.
`plan`
    What a manoeuvre would show, before anyone drives it.
`report`
    The page.
`compare`
    Whether one set of recordings differs from another.
`groups`
    What groups of logs share, and what is specific to each.
"""

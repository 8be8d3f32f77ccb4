"""Recalibration: the model of a daemon in shadow mode keeps up with its robot.

`change`
    Whether the gap between measured and simulated has left its usual range.
`spending`, `flips`
    How sure a confirmation has to be, and the test that says whether it is.
`windows`
    The rolling window on disk.
`proposals`, `history`
    What the engineer decides on, and the file that keeps every look and decision.
`loop`
    Which window is looked at next, and what follows from what was seen: no clock, no file.
`orders`, `judging`, `worker`
    What a look is asked and answers, the look itself, its process: these alone know the diagnosis.
`gap`, `patches`, `process`, `part`, `link`
    The daemon's side: files, processes, and everything that doors show.
"""

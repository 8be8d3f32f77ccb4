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
`orders`, `judging`
    What a look is asked and answers, and the look itself; only this file knows the diagnosis.
"""

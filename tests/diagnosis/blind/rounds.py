"""Rounds of blind logs: some drives with nothing hidden, then causes that these drives show."""

from hilserver_injector import CAUSES

from tests.diagnosis.blind.drawing import (
    Drive,
    Shown,
    hidden,
    kind_of,
    middle_m,
    null,
    seed_of,
)
from tests.diagnosis.blind.judging import diagnosed, told


def judged(all_hidden):
    """What was told of each of these logs: one process for each kind of machine."""
    found = {}
    for machine in sorted({made.drive.machine for made in all_hidden}):
        mine = [made for made in all_hidden if made.drive.machine == machine]
        findings = diagnosed([made.log() for made in mine], machine)
        found |= dict(zip(map(id, mine), findings, strict=True))
    return [(told(made, found[id(made)]), found[id(made)]) for made in all_hidden]


class Round:
    """The drives of one secret, with the smallest sizes that they would show."""

    def __init__(self, secret, makers, lengths_s):
        self.secret = secret
        self.makers = makers  # by kind of drive, like the lengths of its logs
        self.lengths_s = lengths_s
        self.shown = {}  # by drive

    def can_hide(self, cause):
        """Whether there is a drive that shows a cause, and its generator can hide it."""
        return kind_of(cause) in self.makers and self.drive_of(cause).can_hide(
            [CAUSES[cause].parameter]
        )

    def drive_of(self, cause):
        """The drive that shows a cause."""
        kind = kind_of(cause)
        maker = self.makers[kind]
        return Drive(
            maker, kind, seed_of(self.secret, kind, maker), self.lengths_s[kind]
        )

    def measure(self, drives):
        """Judge a log of each drive with nothing hidden; return logs and answers of new drives."""
        new = [drive for drive in dict.fromkeys(drives) if drive not in self.shown]
        logs = [null(drive, seed_of(self.secret, drive.seed, "null")) for drive in new]
        answers = []
        for log, (said, findings) in zip(logs, judged(logs), strict=True):
            answers.append((log, said))
            sizes = {d.cause: d.size for d in findings.smallest_detectable}
            self.shown[log.drive] = Shown(sizes, middle_m(log.log()))
        return answers

    def hidden(self, cause, number=0, fault=False):
        """A log with a cause; None where its drive cannot show it."""
        drive = self.drive_of(cause)
        seed = seed_of(self.secret, drive.seed, cause, number)
        return hidden(cause, drive, self.shown[drive], seed, fault)

"""A drive that is no robot: samples that are a sum of known columns and noise."""

import itertools

import numpy as np

from hilserver.diagnosis.catalogue.candidate import Candidate
from hilserver.diagnosis.noise.whitening import Filter, NoiseModel
from hilserver.diagnosis.regression.columns import Library
from hilserver.diagnosis.regression.problem import Problem
from hilserver.diagnosis.replay.drive_stage import DriveStage
from hilserver.diagnosis.replay.model import Model
from hilserver.diagnosis.replay.stack import make_stack
from hilserver.measured.clock import cut
from hilserver.measured.data import Channel, LogSource, MeasuredLog, Span
from hilserver.plant.parameters import RobotParameters

SIGNAL = "wheel.fl.speed_rpm"
PERIOD_S = 0.02


def whitened(model, t_s, columns, weights=None):
    """Columns of one stretch through the whitening operator of a noise."""
    t_s = np.asarray(t_s, float)
    weights = np.ones(len(t_s)) if weights is None else np.asarray(weights, float)
    made = Filter.empty(len(t_s))
    made.prepare(slice(None), model, t_s, weights)
    return made.whiten(columns)


def measured_log(values, *, edges=None, blocks=None, period_s=PERIOD_S):
    """A log of one channel; `edges` are the first rows of its spans, and the last one's end."""
    values = np.asarray(values, float)
    edges = [0, len(values)] if edges is None else edges
    t_s = np.arange(len(values)) * period_s
    span = np.repeat(np.arange(len(edges) - 1), np.diff(edges))
    spans = tuple(
        Span(k, None if blocks is None else blocks[k], float(t_s[a]), float(t_s[b - 1]))
        for k, (a, b) in enumerate(itertools.pairwise(edges))
    )
    channel = Channel(t_s, values, span)
    return MeasuredLog((LogSource("toy.csv", "0" * 64),), {SIGNAL: channel}, spans)


class LinearStage(DriveStage):
    """A stage without memory that predicts a sum of columns, one per term.

    Only the replay is replaced; whoever asks for more of a drive than samples fails.
    """

    def __init__(self, values, columns, *, block_s=1.0):
        self.log = measured_log(values)
        self.robot = RobotParameters()
        self.segments = cut(self.log, self.robot.period_s, None)
        self.stack = make_stack(self.log, [SIGNAL], self.segments, block_s=block_s)
        self.columns = columns

    def on(self, stack):
        """Some of the samples, and of the columns."""
        rows = np.searchsorted(self.stack.at, stack.at)
        other = super().on(stack)
        other.columns = {name: column[rows] for name, column in self.columns.items()}
        return other

    def predict(self, terms, poses=None, *, keep=False):
        predicted = np.zeros(len(self.stack))
        for name, value in terms.items():
            predicted += value * self.columns[name]
        return predicted


def candidate(name, least=0.0, hidden=0, prior=np.inf):
    return Candidate(
        cause=name, label=name, stage="drive", start=(0.0,), null=(0.0,), step=(0.1,),
        terms=lambda theta: {name: float(theta[0])}, low=(-np.inf,), high=(np.inf,), least=least,
        hidden=hidden, prior=prior,
    )  # fmt: skip


def problem(values, columns, *, block_s=1.0, noise_sd=1.0):
    """A regression whose noise is said to be white, whatever it is."""
    made = Problem(LinearStage(values, columns, block_s=block_s))
    made.noise = {SIGNAL: NoiseModel(noise_sd)}
    return made


def library(made, names=None, hidden=None, prior=None):
    """All columns of a problem as candidates, and its empty model."""
    hidden, prior = hidden or {}, prior or {}
    base = made.point(Model(), np.zeros((0, 3)))
    candidates = [
        candidate(n, hidden=hidden.get(n, 0), prior=prior.get(n, np.inf))
        for n in names or made.stage.columns
    ]
    raw = [made.column(base, c).astype(np.float32) for c in candidates]
    lib = Library(made, candidates, raw)
    lib.rewhiten(base)
    return lib, base


def model(*names):
    made = Model()
    for name in names:
        made = made.plus(candidate(name), (0.0,))
    return made


def ornstein_uhlenbeck(rng, n, tau_s, period_s=PERIOD_S):
    """Noise of variance 1 that forgets itself over `tau_s`."""
    keep = np.exp(-period_s / tau_s)
    steps = rng.normal(size=n) * np.sqrt(1.0 - keep**2)
    steps[0] = rng.normal()
    out = np.empty(n)
    level = 0.0
    for i, step in enumerate(steps):
        level = keep * level + step
        out[i] = level
    return out


def smooth(rng, n, width=40):
    """A column that varies slowly, as the effects of a drive do."""
    return np.convolve(rng.normal(size=n + width), np.ones(width) / width, "valid")[:n]

"""What a regression needs from a replay, whichever part of the machine is replayed."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from copy import copy
from typing import ClassVar, Final, Self

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.catalogue.candidate import Candidate, StageName
from hilserver.diagnosis.catalogue.traits import Need
from hilserver.diagnosis.catalogue.vocabulary import Block
from hilserver.diagnosis.replay.stack import Stack
from hilserver.measured.clock import Segments
from hilserver.measured.data import MeasuredLog
from hilserver.plant.parameters import RobotParameters

NO_POSES: Final = np.zeros((0, 3))


class Stage(ABC):
    """The replay of one part of the machine, from what the log holds of its input."""

    name: ClassVar[StageName]  # the name that candidates use
    block: ClassVar[Block]  # where an error arises that no cause explains
    # its sensors have no memory: what neighbouring samples share is a misfit, not noise
    memoryless: ClassVar[bool]
    # it predicts nothing where the log does not hold the set-points that the machine received
    follows_setpoints: ClassVar[bool]
    needs: ClassVar[tuple[Need, ...]]  # what its causes may need in the log
    # channels whose errors are reported sample by sample, by the name of the quantity
    quantities: ClassVar[Mapping[str, tuple[str, ...]]]
    log: MeasuredLog
    robot: RobotParameters
    segments: Segments  # pieces of the log with a new start
    stack: Stack  # measured samples of the channels that it predicts

    @abstractmethod
    def candidates(self) -> list[Candidate]:
        """Return the candidates that it could judge with all of its channels."""

    @abstractmethod
    def predict(
        self, terms: Mapping[str, float], poses: Array, *, keep: bool = False
    ) -> Array:
        """Return what the stack's samples would be.

        Parameters
        ----------
        poses : ndarray, shape (segments, 3)
            Initial poses; empty where there are none.
        keep : bool
            Whether the next predictions will differ from this one only in sensors.
        """

    @abstractmethod
    def signals(self, terms: Mapping[str, float], poses: Array) -> Mapping[str, Array]:
        """Return the signals of the replay itself, at every tick and without noise."""

    def difference(self, samples: Array, others: Array) -> Array:
        """Return samples minus others; angles the shorter way round."""
        return samples - others

    def start_poses(self, terms: Mapping[str, float]) -> Array:
        """Return a first guess of the initial poses; a stage may have none."""
        del terms
        return NO_POSES

    def nuisance(self, predicted: Array, poses: Array) -> Array | None:
        """Return the derivative of the prediction by the initial poses, if free; shape (n, 3).

        Their columns are projected out of every fit.
        """
        del predicted, poses
        return None

    def on(self, stack: Stack) -> Self:
        """Return the stage with some of its samples."""
        other = copy(self)
        other.stack = stack
        return other

    def uncut(self) -> "Stage":
        """Return the stage with whole spans as its segments."""
        return self

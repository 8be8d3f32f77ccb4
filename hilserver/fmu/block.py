"""An FMU as an own block: declared from its description, started once for every robot."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

import hilserver.fmu.layout as at
from hilserver.compiled.cache import hash_of
from hilserver.fmu import calls, exchange
from hilserver.fmu.description import Fmu, read_fmu
from hilserver.fmu.library import FmuLibrary, Instance
from hilserver.fmu.process import Child
from hilserver.fmu.wiring import Start, Wiring, signals, wire
from hilserver.kernel.composition import Foreign, News, Setting
from hilserver.plant.blocks import MOST_PER_BLOCK, BlockDeclaration, BlockError, Output

SLOW_SHARE: Final = 0.5  # a call is slow from this share of a tick on
LATE: Final = Output(
    "process_late",
    low=-(2**53),
    high=2**53,
    description="Slices without an answer so far; negative once the FMU was given up",
    is_replayed=True,
)


@dataclass(frozen=True)
class FmuModel:
    """An FMU as configured; `start` gives each robot its own instance."""

    fmu: Fmu
    wiring: Wiring
    beside: bool  # whether it runs in a process of its own

    @property
    def identity(self) -> bytes:
        """What two runs must have in common for one to continue the other."""
        start = sorted((v.name, repr(value)) for v, value in self.wiring.start)
        shown = [v.name for v in self.wiring.outputs]
        return repr((self.fmu.sha256, start, shown, self.beside)).encode()

    @property
    def not_replayable(self) -> str:
        """Why a recording with it cannot be replayed; empty if it can."""
        if self.fmu.stores_state:
            return ""
        return f"FMU '{self.fmu.path.name}' cannot store its state"

    @property
    def remark(self) -> str:
        """What its user should know; empty if there is nothing."""
        n = self.wiring.left_out
        if n == 0:
            return ""
        return (
            f"FMU '{self.fmu.path.name}': {n} tunable parameters beyond the first"
            f" {MOST_PER_BLOCK} keep their values; those named in 'start' come first"
        )

    def start(self, name: str, setting: Setting) -> Foreign:
        """Start it; BlockError, one sentence, if it does not start."""
        try:
            if self.beside:
                return Beside(self, name, setting)
            return Here(self, name, setting)
        except BlockError as error:
            raise BlockError(f"FMU '{name}' ({self.fmu.path.name}) {error}.") from None


def load_fmu_block(
    reference: str,
    base_dir: Path,
    *,
    inputs: Mapping[str, str],
    outputs: Mapping[str, str],
    start: Mapping[str, Start],
    process: bool,
) -> tuple[BlockDeclaration, FmuModel]:
    """Return the block that an FMU becomes, and its model; arguments as in the configuration.

    BlockError, one sentence: what is wrong with the FMU, or missing in it.
    """
    fmu = read_fmu(reference, base_dir)
    wiring = wire(fmu, inputs, outputs, start)
    if not process:
        try:
            FmuLibrary(fmu)  # with a process of its own it is only loaded there
        except BlockError as error:
            raise BlockError(f"FMU {reference!r} {error}.") from None
    given = {variable.name: value for variable, value in wiring.start}
    function = exchange.run_beside if process else calls.run_here
    shown = (*signals(wiring, outputs), *([LATE] if process else []))
    parameters = {v.name: float(given.get(v.name, v.start)) for v in wiring.parameters}
    declaration = BlockDeclaration(
        name=fmu.identifier,
        function=function,
        inputs=wiring.input_names,
        outputs=shown,
        state={},
        parameters=parameters,
        source=fmu.path,
        source_function=calls.run_here,
    )
    return declaration, FmuModel(fmu, wiring, process)


@cache
def _key() -> str:
    return hash_of(sorted(Path(__file__).parent.glob("*.py")))


class _Running:
    """A started FMU, in this process or another; attributes as in `Foreign`."""

    def __init__(self, name: str, part: Instance | Child) -> None:
        self.addresses = part.addresses
        self.initial = part.initial
        self.key = _key()
        self._name = name
        self._part = part
        self._reported = at.OK

    def _failed(self, status: int) -> list[News]:
        """Return the failure if it is a new one."""
        if status == self._reported:
            return []
        self._reported = status
        if status == at.OK:
            return []
        answer = self._part.message or at.STATUS.get(status, f"status {status}")
        return [News(f"FMU '{self._name}' failed: {answer}", is_fault=True)]

    def close(self) -> None:
        """End it."""
        self._part.close()


class Here(_Running):
    """An FMU that the step calls directly."""

    step, keep, adopt = calls.run_here, calls.keep_here, calls.adopt_here

    def __init__(self, model: FmuModel, name: str, setting: Setting) -> None:
        slow_ns = round(setting.base_period_s * SLOW_SHARE * 1e9)
        super().__init__(name, Instance(model.fmu, model.wiring, name, slow_ns))

    def look(self, a: NDArray[np.int64]) -> Sequence[News]:
        """Return what happened since the last look."""
        return self._failed(int(a[at.A_STATUS]))


class Beside(_Running):
    """An FMU in a process of its own."""

    step, keep, adopt = exchange.run_beside, exchange.keep_beside, exchange.adopt_beside

    def __init__(self, model: FmuModel, name: str, setting: Setting) -> None:
        self._child = Child(model.fmu, model.wiring, name, setting)
        super().__init__(name, self._child)
        self._status = at.OK
        self._late = 0
        self._hurried = 0
        self._is_lost = False

    def look(self, a: NDArray[np.int64]) -> Sequence[News]:
        """Return what happened since the last look; start it again if it has ended."""
        status = int(a[at.A_STATUS])
        hurried = int(a[at.A_HURRIED])
        late = int(a[at.A_LATE]) - hurried
        if status == at.OK != self._status:
            self._is_lost = False  # a state was restored: its process continues from it
        gives_up = status == at.SILENT and not self._is_lost
        ended = self._child.look(a, gives_up=gives_up)
        self._is_lost |= ended is not None
        self._status = status
        if ended is None:
            news = []
        else:
            news = [News(f"FMU '{self._name}' {ended}", is_fault=True)]
        if status != at.SILENT:  # its end is reported already
            news += self._failed(status)
        if late > self._late and not news:
            news.append(self._holds(f"did not answer in {late - self._late} slices"))
        if hurried > self._hurried and not news:
            n = hurried - self._hurried
            news.append(
                self._holds(f"had no time in {n} slices while the plant caught up")
            )
        self._late = late
        self._hurried = hurried
        return news

    def _holds(self, why: str) -> News:
        return News(
            f"FMU '{self._name}' {why}: its outputs keep their last values",
            is_fault=False,
        )

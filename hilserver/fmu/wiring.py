"""Which variables of an FMU are inputs, outputs and parameters of the block it becomes."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from hilserver.fmu.description import Fmu, FmuVariable
from hilserver.plant.blocks import MOST_PER_BLOCK, BlockError, Output

Start = float | str | bool
_TEXT: Final = -1


@dataclass(frozen=True)
class Wiring:
    """Variables in the order of their values in `u`, `p` and `y`."""

    inputs: Sequence[FmuVariable]
    parameters: Sequence[FmuVariable]
    outputs: Sequence[FmuVariable]
    # variables whose start value differs from the FMU's
    start: Sequence[tuple[FmuVariable, Start]]
    left_out: int = 0  # tunable parameters that a block has no room for

    @property
    def n_inputs(self) -> int:
        """Length of `u`."""
        return sum(v.count for v in self.inputs)

    @property
    def n_parameters(self) -> int:
        """Length of `p`."""
        return sum(v.count for v in self.parameters)

    @property
    def n_outputs(self) -> int:
        """Length of `y`."""
        return sum(v.count for v in self.outputs)

    @property
    def rows(self) -> Sequence[tuple[str, Sequence[FmuVariable]]]:
        """How the variables are accessed: ``Set`` and ``Get``."""
        return ("Set", self.inputs), ("Set", self.parameters), ("Get", self.outputs)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names in the order of `u`."""
        return tuple(name for v in self.inputs for name in v.scalars)


def _check_inputs(fmu: Fmu, inputs: Mapping[str, FmuVariable]) -> None:
    """BlockError if one of these is no input, or only a part of an array is wired."""
    for name, variable in inputs.items():
        if variable.causality != "input":
            raise BlockError(
                f"'{name}' of {fmu.path.name} is {variable.causality}, not input"
            )
        missing = [n for n in variable.scalars if n not in inputs]
        if missing:
            raise BlockError(f"input '{missing[0]}' of {fmu.path.name} is not wired")


def wire(
    fmu: Fmu,
    inputs: Mapping[str, str],
    outputs: Mapping[str, str],
    start: Mapping[str, Start],
) -> Wiring:
    """Find the variables that a configuration names.

    BlockError if one is missing, or cannot be used that way.

    Parameters
    ----------
    inputs : mapping of str
        Variable: signal.
    outputs : mapping of str
        Variable of any causality: end of the signal's name; empty: all outputs, under their own
        names.
    start : mapping
        Variable: value.
    """
    taken = [_whole(fmu, name) for name in inputs]
    _check_inputs(fmu, dict(zip(inputs, taken, strict=True)))
    every = fmu.variables.values()
    shown = [_whole(fmu, name) for name in outputs]
    if not outputs:
        shown = [v for v in every if v.causality == "output" and v.kind != _TEXT]
    tunable = [v for v in every if _is_tunable(v)]
    # those that the user has set come first
    tunable.sort(key=lambda v: v.name not in start)
    by_type = sorted(tunable[:MOST_PER_BLOCK], key=lambda v: v.type)
    started = [(_startable(fmu, name, value), value) for name, value in start.items()]
    wiring = Wiring(
        inputs=list(dict.fromkeys(taken)),
        # Those of one type are set in one call: values that only fit together must not be split.
        parameters=by_type,
        outputs=list(dict.fromkeys(shown)),
        start=started,
        left_out=max(0, len(tunable) - MOST_PER_BLOCK),
    )
    if not wiring.n_outputs:
        raise BlockError(
            f"{fmu.path.name} has no numeric output, so it would have no effect"
        )
    for what, n in (("inputs", wiring.n_inputs), ("outputs", wiring.n_outputs)):
        if n > MOST_PER_BLOCK:
            raise BlockError(
                f"{fmu.path.name}: {n} {what} are too many; at most {MOST_PER_BLOCK} are possible:"
                f" name some of them"
            )
    return wiring


def signals(wiring: Wiring, names: Mapping[str, str]) -> tuple[Output, ...]:
    """Return the outputs as they appear in the signal table, in the order of `y`.

    BlockError if two would have the same name.
    """
    found = []
    for variable in wiring.outputs:
        for name in variable.scalars:
            shown = names.get(name) or _plain(name)
            low = variable.low
            high = variable.high
            if not low < high:
                low = -1e9
                high = 1e9
            found.append(Output(shown, variable.unit, low, high, variable.description))
    twice = [o.name for o in found if [x.name for x in found].count(o.name) > 1]
    if twice:
        raise BlockError(
            f"two outputs would be '{twice[0]}'; give them names in 'outputs'"
        )
    return tuple(found)


def _plain(name: str) -> str:
    """Return the end of a signal's name for a variable: lower case, digits and _."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") or "value"


def _whole(fmu: Fmu, name: str) -> FmuVariable:
    """Return the variable with a name, or the array with an element: ``u[2]``."""
    variable = fmu.variables.get(name) or fmu.variable(name.partition("[")[0])
    if variable.kind == _TEXT:
        raise BlockError(
            f"'{name}' of {fmu.path.name} is text, which cannot be a signal"
        )
    if variable.count > MOST_PER_BLOCK:
        raise BlockError(
            f"'{variable.name}' of {fmu.path.name} has {variable.count} values; at most"
            f" {MOST_PER_BLOCK} are possible"
        )
    if name not in variable.scalars:
        raise BlockError(
            f"{fmu.path.name} has '{variable.scalars[0]}', but no '{name}'"
        )
    return variable


def _startable(fmu: Fmu, name: str, value: Start) -> FmuVariable:
    variable = fmu.variable(name)
    if variable.causality not in ("parameter", "input") or variable.shape:
        why = "an array" if variable.shape else variable.causality
        raise BlockError(
            f"'{name}' of {fmu.path.name} takes no start value: it is {why}"
        )
    if isinstance(value, str) != (variable.kind == _TEXT):
        kind = "text" if variable.kind == _TEXT else "a number"
        raise BlockError(f"'{name}' of {fmu.path.name} takes {kind}, not {value!r}")
    return variable


def _is_tunable(variable: FmuVariable) -> bool:
    is_parameter = (
        variable.causality == "parameter" and variable.variability == "tunable"
    )
    return is_parameter and not variable.shape and variable.kind != _TEXT

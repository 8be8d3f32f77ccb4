"""Own blocks: a user's numba function as a part of the plant.

A block is declared beside its code; `config.yaml` names it, wires its inputs and assigns it to a
slice. The function runs compiled in the pacing back end::

    from hilserver.plant.blocks import Output, block

    @block(inputs=("duty_pct",), outputs=(Output("force_n", unit="N", low=-50.0, high=50.0),),
           state=("force",), parameters={"gain": 0.4, "lag_s": 0.1})
    def load_cell(dt_s, u, y, x, p):
        x[0] += dt_s / p[1] * (p[0] * u[0] - x[0])
        y[0] = x[0]

`u`, `y`, `x` and `p` are float64 arrays in the order of the declaration, `dt_s` is the period of
the slice. What the block remembers must be in `x`, because snapshots hold nothing else of it.
"""

import importlib
import importlib.util
import math
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numba
from numba.core.errors import NumbaError

from hilserver.compiled import kernel
from hilserver.plant.errors import PlantError

MOST_PER_BLOCK: Final = 256
_NAME = re.compile(r"[a-z][a-z0-9_]*")
_ATTRIBUTE: Final = "__hilserver_block__"
_ARRAY = numba.float64[::1]
_SIGNATURE = numba.void(numba.float64, _ARRAY, _ARRAY, _ARRAY, _ARRAY)


class BlockError(PlantError):
    """An own block that cannot be used; one sentence that names file and line."""


@dataclass(frozen=True, slots=True)
class Output:
    """One output of a block, as it appears in the signal table."""

    name: str  # ends in its unit, as every signal: ``force_n``
    unit: str = "1"  # symbol of the unit, "1" without one
    # range
    low: float = -1e9
    high: float = 1e9
    description: str = ""  # one line for the address space
    # hidden, and also an input: a replay uses the recorded value
    is_replayed: bool = False


@dataclass(frozen=True, slots=True)
class BlockDeclaration:
    """What `block` declares about a function and `load_block` compiles."""

    name: str  # name of the function
    # ``(dt_s, u, y, x, p) -> None``, compiled after `load_block`
    function: Callable[..., None]
    # own names of the inputs, in the order of `u`; the configuration wires them to signals
    inputs: tuple[str, ...]
    outputs: tuple[Output, ...]  # in the order of `y`
    state: Mapping[str, float]  # names and initial values, in the order of `x`
    parameters: Mapping[str, float]  # names and defaults, in the order of `p`
    source: Path  # file of the function; part of the kernel cache's key
    source_function: Callable[..., None]  # the function as it was written


def block(
    *,
    inputs: Sequence[str] = (),
    outputs: Sequence[Output] = (),
    state: Sequence[str] | Mapping[str, float] = (),
    parameters: Mapping[str, float] | None = None,
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Declare a function ``(dt_s, u, y, x, p)`` as a block.

    Parameters
    ----------
    inputs : sequence of str
        Own names of the inputs.
    outputs : sequence of Output
        At least one.
    state : sequence of str, or mapping of str to float
        Names, with initial values of 0, or names with their initial values.
    parameters : mapping of str to float
        Names and defaults.
    """
    if isinstance(inputs, str) or isinstance(state, str):
        raise TypeError(
            'inputs and state are tuples of names: one name is written ("name",)'
        )
    initial = dict(state) if isinstance(state, Mapping) else dict.fromkeys(state, 0.0)

    def declare(function: Callable[..., None]) -> Callable[..., None]:
        code = getattr(function, "py_func", function)
        declaration = BlockDeclaration(
            name=code.__name__,
            function=code,
            inputs=tuple(inputs),
            outputs=tuple(outputs),
            state=initial,
            parameters=dict(parameters or {}),
            source=Path(code.__code__.co_filename),
            source_function=code,
        )
        setattr(function, _ATTRIBUTE, declaration)
        return function

    return declare


def load_block(reference: str, base_dir: Path) -> BlockDeclaration:
    """Import, check and compile a block.

    BlockError, with file and line, when the module or function is missing, the function is not
    declared, the declaration is wrong, or the function does not compile.

    Parameters
    ----------
    reference : str
        ``package.module:function`` or ``path/file.py:function``.
    base_dir : Path
        Base of relative paths: the directory of the configuration file.
    """
    place, colon, name = reference.rpartition(":")
    if not colon or not place or not name:
        raise BlockError(
            f"block {reference!r}: write package.module:function or path/file.py:function."
        )
    module = _import(place, reference, base_dir)
    function = getattr(module, name, None)
    if function is None:
        raise BlockError(
            f"block {reference!r}: there is no function {name!r} in {place}."
        )
    declaration = getattr(function, _ATTRIBUTE, None)
    if not isinstance(declaration, BlockDeclaration):
        raise BlockError(
            f"block {reference!r}: {name} is not declared; put @block(...) above it."
        )
    _check(declaration, reference)
    return _compile(declaration, reference)


def _import(place: str, reference: str, base_dir: Path) -> ModuleType:
    if not place.endswith(".py"):
        try:
            return importlib.import_module(place)
        except (Exception, SystemExit) as error:
            raise BlockError(
                f"block {reference!r}: importing {place} failed: {_one_line(error)}."
            ) from error
    path = (base_dir / place).resolve()
    if not path.is_file():
        raise BlockError(f"block {reference!r}: there is no file {path}.")
    module_name = f"hilserver_block_{path.stem}"
    spec = importlib.util.spec_from_file_location(module_name, path)
    if spec is None or spec.loader is None:
        raise BlockError(f"block {reference!r}: {path} is not a Python file.")
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[module_name]
        line = getattr(error, "lineno", None) or _line_of(error, path)
        raise BlockError(
            f"block {reference!r}: {path}:{line} failed on import: {_one_line(error)}."
        ) from error
    return module


def _line_of(error: BaseException, path: Path) -> int:
    line, trace = 1, error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == str(path):
            line = trace.tb_lineno
        trace = trace.tb_next
    return line


def _one_line(error: BaseException) -> str:
    text = re.sub(r"\x1b\[[0-9;]*m", "", str(error)).strip()
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    useful = [
        line for line in lines if not line.startswith(("Failed in", "During:", "File "))
    ]
    return (useful or lines or [type(error).__name__])[0].rstrip(".")


def _check(declaration: BlockDeclaration, reference: str) -> None:
    problem = (
        _wrong_output(declaration.outputs)
        or _wrong_name(declaration)
        or _wrong_number({**declaration.state, **declaration.parameters})
    )
    if problem:
        raise BlockError(f"block {reference!r}: {problem}.")


def _wrong_output(outputs: Sequence[object]) -> str:
    """Return what is wrong with the outputs; empty if nothing is."""
    if not outputs:
        return "declares no output, so nothing could be seen of it"
    for output in outputs:
        if not isinstance(output, Output):
            return f'{output!r} in outputs is not an output; write Output("name")'
        low, high, texts = output.low, output.high, (output.unit, output.description)
        if not (_is_finite(low) and _is_finite(high) and low < high):
            return f"the range of {output.name} must be finite, low below high"
        if not all(isinstance(text, str) for text in texts):
            return f"unit and description of {output.name} must be strings"
    return ""


def _wrong_name(declaration: BlockDeclaration) -> str:
    groups: dict[str, Sequence[str]] = {
        "inputs": declaration.inputs,
        "outputs": [output.name for output in declaration.outputs],
        "state": list(declaration.state),
        "parameters": list(declaration.parameters),
    }
    for group, names in groups.items():
        wrong = [n for n in names if not isinstance(n, str) or not _NAME.fullmatch(n)]
        twice = [n for n in names if list(names).count(n) > 1]
        if wrong:
            return f"{wrong[0]!r} in {group} is not a name of lower-case letters, digits and _"
        if twice:
            return f"{twice[0]!r} appears twice in {group}"
        if len(names) > MOST_PER_BLOCK:
            return (
                f"{group} has {len(names)} names, at most {MOST_PER_BLOCK} are possible"
            )
    return ""


def _wrong_number(numbers: Mapping[str, object]) -> str:
    for name, value in numbers.items():
        if not _is_finite(value):
            return f"{name} must be a finite number, not {value!r}"
    return ""


def _is_finite(value: object) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)


def _compile(declaration: BlockDeclaration, reference: str) -> BlockDeclaration:
    code: Any = declaration.function
    where = f"{declaration.source}:{code.__code__.co_firstlineno}"
    if code.__code__.co_argcount != 5:
        raise BlockError(f"block {reference!r}: {where} must take (dt_s, u, y, x, p).")
    try:
        # a wrong index must not write into the robot's memory: it raises, and the step catches that
        compiled = kernel(_SIGNATURE, boundscheck=True)(code)
    except NumbaError as error:
        line = getattr(getattr(error, "loc", None), "line", None)
        found = re.search(r'File "[^"]*", line (\d+)', str(error))
        line = line or (int(found.group(1)) if found else code.__code__.co_firstlineno)
        raise BlockError(
            f"block {reference!r}: {declaration.source}:{line} does not compile: "
            f"{_one_line(error)}."
        ) from error
    return BlockDeclaration(
        name=declaration.name,
        function=compiled,
        inputs=declaration.inputs,
        outputs=declaration.outputs,
        state=declaration.state,
        parameters=declaration.parameters,
        source=declaration.source.resolve(),
        source_function=code,
    )

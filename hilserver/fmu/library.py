"""The machine code of an FMU: loaded, its functions by name, an instance started and ended."""

import ctypes
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

import numba
import numpy as np
from numpy.typing import NDArray

import hilserver.fmu.layout as at
from hilserver.compiled import kernel
from hilserver.compiled.cache import c_function
from hilserver.fmu import calls
from hilserver.fmu.description import Fmu, FmuVariable
from hilserver.fmu.wiring import Start, Wiring
from hilserver.plant.blocks import BlockError

_TIMES: Final = ("SetupExperiment", "EnterInitializationMode", "ExitInitializationMode")
_NEEDED: Final[Mapping[int, Sequence[str]]] = {
    2: ("Instantiate", *_TIMES, "DoStep", "Terminate", "FreeInstance"),
    3: ("InstantiateCoSimulation", *_TIMES[1:], "DoStep", "Terminate", "FreeInstance"),
}
_OF_STATE: Final[Mapping[int, tuple[str, str]]] = {
    at.A_GET_STATE: ("GetFMUstate", "GetFMUState"),
    at.A_SET_STATE: ("SetFMUstate", "SetFMUState"),
    at.A_FREE_STATE: ("FreeFMUstate", "FreeFMUState"),
    at.A_STATE_SIZE: ("SerializedFMUstateSize", "SerializedFMUStateSize"),
    at.A_SERIALIZE: ("SerializeFMUstate", "SerializeFMUState"),
    at.A_DESERIALIZE: ("DeSerializeFMUstate", "DeserializeFMUState"),
}
"""Functions that store a state, as FMI 2.0 and as 3.0 spells them."""
_C_TYPES: Final[Mapping[tuple[int, int], Any]] = {
    (at.FLOAT, 8): ctypes.c_double, (at.FLOAT, 4): ctypes.c_float,
    (at.SIGNED, 1): ctypes.c_int8, (at.SIGNED, 2): ctypes.c_int16,
    (at.SIGNED, 4): ctypes.c_int32, (at.SIGNED, 8): ctypes.c_int64,
    (at.UNSIGNED, 1): ctypes.c_uint8, (at.UNSIGNED, 2): ctypes.c_uint16,
    (at.UNSIGNED, 4): ctypes.c_uint32, (at.UNSIGNED, 8): ctypes.c_uint64,
    (at.BOOLEAN, 1): ctypes.c_bool, (at.BOOLEAN, 4): ctypes.c_int32,
}  # fmt: skip
MOST_STATE_BYTES: Final = 1 << 20  # a larger state would not fit between two ticks
_OCTETS = numba.types.CPointer(numba.types.uint8)
_LAST: Final = 8 * at.MESSAGE_WORDS - 1


@kernel()
def _take(status: int, text: Any, buffer: Any) -> None:
    """Keep an FMU's error message; the paced thread may call this."""
    if status <= at.WARNING:
        return
    i = 0
    while i < _LAST and text[i] != 0:
        buffer[i] = text[i]
        i += 1
    buffer[i] = 0


@c_function(numba.void(_OCTETS, _OCTETS, numba.int32, _OCTETS, _OCTETS))
def _log_2(
    environment: Any, _name: Any, status: int, _category: Any, text: Any
) -> None:
    _take(status, text, environment)


@c_function(numba.void(_OCTETS, numba.int32, _OCTETS, _OCTETS))
def _log_3(environment: Any, status: int, _category: Any, text: Any) -> None:
    _take(status, text, environment)


class FmuLibrary:
    """A loaded FMU; BlockError if it cannot be loaded, or lacks a function."""

    def __init__(self, fmu: Fmu) -> None:
        self._fmu = fmu
        try:
            self._symbols = ctypes.CDLL(str(fmu.library))
        except OSError as error:
            why = str(error).replace(str(fmu.folder), fmu.path.name)
            raise BlockError(
                f"cannot be loaded: {why}; export it for this computer"
            ) from None
        wanted = [*_NEEDED[fmu.version]]
        if fmu.stores_state:
            wanted += [names[fmu.version - 2] for names in _OF_STATE.values()]
        for name in wanted:
            self.function(name)

    def function(self, name: str, result: Any = ctypes.c_int) -> Any:
        """Return a function by its name without ``fmi2`` or ``fmi3``."""
        full = f"fmi{self._fmu.version}{name}"
        try:
            found = getattr(self._symbols, full)
        except AttributeError:
            raise BlockError(f"lacks the function {full}; export it again") from None
        found.restype = result
        return found

    def address(self, name: str) -> int:
        """Return where a function is."""
        return ctypes.cast(self.function(name), ctypes.c_void_p).value or 0


class Instance:
    """A started FMU; it is stepped through its addresses and must outlive them."""

    def __init__(self, fmu: Fmu, wiring: Wiring, name: str, slow_ns: int) -> None:
        self._fmu = fmu
        self._library = FmuLibrary(fmu)
        self.message_words = np.zeros(at.MESSAGE_WORDS, dtype=np.int64)
        self._callbacks: Any = None
        self._instance = ctypes.c_void_p(self._instantiated(name.encode()))
        if not self._instance:
            raise BlockError(f"does not start: {self.message or 'it gives no reason'}")
        self._set_start(dict(wiring.start))
        zero = ctypes.c_double(0.0)
        no = ctypes.c_int(0) if self._fmu.version == 2 else ctypes.c_bool(False)
        if self._fmu.version == 2:
            self._call("SetupExperiment", no, zero, zero, no, zero)
            self._call("EnterInitializationMode")
        else:
            self._call("EnterInitializationMode", no, zero, zero, no, zero)
        self._call("ExitInitializationMode")
        # the kernels' `a`, valid in this process
        self.addresses = self._addresses(wiring, slow_ns)
        self.outputs = np.zeros(wiring.n_outputs)  # `y` at time 0
        a = self.addresses
        n_before = int(a[at.A_INPUTS] + a[at.A_PARAMETERS])
        answer = calls.access(
            n_before, int(a[at.A_OUTPUTS]), self.outputs, a, gets=True
        )
        self._check(answer)
        self.initial = self._state()  # `x` of the kernels at time 0

    @property
    def message(self) -> str:
        """The FMU's message about its last error."""
        return text_of(self.message_words)

    def close(self) -> None:
        """End it."""
        if self._instance:
            self._library.function("Terminate")(self._instance)
            self._library.function("FreeInstance", None)(self._instance)
            self._instance = ctypes.c_void_p(None)

    def _instantiated(self, name: bytes) -> int:
        fmu = self._fmu
        environment = ctypes.c_void_p(self.message_words.ctypes.data)
        token = fmu.token.encode()
        resources = fmu.folder / "resources"
        if fmu.version == 2:
            # logger, allocateMemory, freeMemory, stepFinished, componentEnvironment
            self._callbacks = (ctypes.c_void_p * 5)(
                _log_2.address, _libc("calloc"), _libc("free"), None, environment
            )
            uri = resources.as_uri().encode()
            instantiate = self._library.function("Instantiate", ctypes.c_void_p)
            return int(instantiate(name, 1, token, uri, self._callbacks, 0, 0) or 0)
        path = f"{resources}/".encode()
        none = ctypes.c_void_p(None)
        no = ctypes.c_bool(False)
        instantiate = self._library.function("InstantiateCoSimulation", ctypes.c_void_p)
        log = ctypes.c_void_p(_log_3.address)
        first = (name, token, path, no, no, no, no, none, ctypes.c_size_t(0))
        return int(instantiate(*first, environment, log, none) or 0)

    def _call(self, name: str, *arguments: Any) -> None:
        self._check(self._library.function(name)(self._instance, *arguments))

    def _check(self, status: int) -> None:
        if status > at.WARNING:
            why = self.message or f"a function answered {at.STATUS.get(status, status)}"
            raise BlockError(f"does not start: {why}")

    def _set_start(self, given: Mapping[FmuVariable, Start]) -> None:
        """Set start values, those of one type in one call."""
        for same in _of_one_type(sorted(given, key=lambda v: v.type)):
            n = len(same)
            first = same[0]
            references = (ctypes.c_uint32 * n)(*(v.reference for v in same))
            if first.type == "String":
                data: Any = (ctypes.c_char_p * n)(
                    *(str(given[v]).encode() for v in same)
                )
            else:
                of_type = _C_TYPES[first.kind, first.bytes] * n
                data = of_type(*(_as_start(v, given[v]) for v in same))
            size = ctypes.c_size_t(n)  # 3.0 alone takes the number of values
            self._call(f"Set{first.type}", references, size, data, size)

    def _addresses(self, wiring: Wiring, slow_ns: int) -> NDArray[np.int64]:
        groups = [
            [(verb, same) for same in _of_one_type(vs)] for verb, vs in wiring.rows
        ]
        rows = []
        references = np.zeros(0, dtype=np.int64)
        values = 0
        first = at.ROWS + at.CALL_WORDS * sum(map(len, groups))
        for verb, same in itertools.chain(*groups):
            n = sum(v.count for v in same)
            v = same[0]
            function = self._library.address(f"{verb}{v.type}")
            rows.append(
                (first + references.size, len(same), n, v.bytes, v.kind, function)
            )
            # 32-bit numbers, two per word.
            numbers = [v.reference for v in same]
            padded = [*numbers, *[0] * (len(numbers) % 2)]
            packed = np.array(padded, dtype=np.uint32).view(np.int64)
            references = np.append(references, packed)
            values = max(values, n)
        scratch = first + references.size
        known = scratch + values
        a = np.zeros(known + wiring.n_parameters, dtype=np.int64)
        a[at.ROWS : first] = np.array(rows, dtype=np.int64).ravel()
        a[first:scratch] = references
        a[at.A_SCRATCH] = scratch
        a[at.A_KNOWN] = known
        a[at.A_FRESH] = 1
        a[at.A_INPUTS], a[at.A_PARAMETERS], a[at.A_OUTPUTS] = map(len, groups)
        a[at.A_INSTANCE] = self._instance.value or 0
        a[at.A_VERSION] = self._fmu.version
        a[at.A_DO_STEP] = self._library.address("DoStep")
        if self._fmu.stores_state:
            for place, names in _OF_STATE.items():
                a[place] = self._library.address(names[self._fmu.version - 2])
        a[at.A_SLOW] = slow_ns
        return a

    def _state(self) -> NDArray[np.float64]:
        """Return `x` at the start; later states may have at most twice its size."""
        if not self._fmu.stores_state:
            return np.zeros(at.X_STATE)
        a = self.addresses
        a[at.A_CAPACITY] = MOST_STATE_BYTES
        x = np.zeros(at.X_STATE + MOST_STATE_BYTES // 8)
        status = calls.store(x, a)
        if status == at.STATE_TOO_LARGE:
            raise BlockError(f"has a state of more than {MOST_STATE_BYTES >> 20} MB")
        self._check(status)
        words = -(-2 * int(x[at.X_BYTES]) // 8)
        a[at.A_CAPACITY] = 8 * words
        return x[: at.X_STATE + words].copy()


def text_of(words: NDArray[np.int64]) -> str:
    """Return a message of an FMU as one line."""
    raw = words.tobytes().partition(b"\0")[0]
    return " ".join(raw.decode(errors="replace").split()).rstrip(".")


def _of_one_type(variables: Iterable[FmuVariable]) -> Iterator[list[FmuVariable]]:
    """Yield groups of neighbours of one type; a group takes one call."""
    for _, same in itertools.groupby(variables, lambda v: v.type):
        yield list(same)


def _libc(name: str) -> int:
    return ctypes.cast(getattr(ctypes.CDLL(None), name), ctypes.c_void_p).value or 0


def _as_start(variable: FmuVariable, value: float | str | bool) -> float | int | bool:
    number = float(value)
    if variable.kind == at.FLOAT:
        return number
    if variable.kind == at.BOOLEAN:
        return number != 0.0
    return round(number)

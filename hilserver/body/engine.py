"""MuJoCo itself: compiles the model and gives the kernel its addresses. Imported only here."""

import ctypes
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from hilserver.body.export import mjcf
from hilserver.body.layout import MUJOCO, N_WARNINGS, Addresses
from hilserver.body.parameters import BodyParameters
from hilserver.body.step import place_body
from hilserver.plant.errors import PlantError

MISSING = "mechatronic.enabled: needs MuJoCo; install it with: pip install 'hilserver[physics]'."


def mujoco() -> ModuleType:
    """Return the library; PlantError if it is not installed."""
    if find_spec("mujoco") is None:
        raise PlantError(MISSING)
    return import_module("mujoco")


class BodyEngine:
    """One model and its data, stepped through its addresses, which it must outlive."""

    def __init__(self, body: BodyParameters) -> None:
        if body.robot.wheelbase_m is None:
            raise PlantError(
                "plant.wheelbase_m: the mechatronic model needs four wheels; give the distance"
                " between the axles."
            )
        library = mujoco()
        self.body = body  # parameters it was made from
        self.model = library.MjModel.from_xml_string(mjcf(body, body.robot.solids))
        self.data = library.MjData(self.model)
        self.parameters = body.pack()  # `p` of the kernel
        signature = int(library.mjtState.mjSTATE_INTEGRATION)
        length = library.mj_stateSize(self.model, signature)
        # `a` of the kernel, of this process
        self.addresses = self._addresses(library, signature)
        # `b` of the kernel: at rest in the origin
        self.initial = self._initial(library, length, signature)

    @property
    def identity(self) -> bytes:
        """Equal for two bodies if one can continue the state of the other."""
        xml = mjcf(self.body, self.body.robot.solids)
        return xml.encode() + self.parameters.tobytes()

    def _addresses(self, library: ModuleType, signature: int) -> Addresses:
        (path,) = Path(library.__file__ or "").parent.glob("libmujoco.so*")
        symbols = ctypes.CDLL(str(path))  # the copy that the bindings loaded
        _silence(symbols)

        def function(name: str, of: ctypes.CDLL = symbols) -> int:
            return ctypes.cast(getattr(of, name), ctypes.c_void_p).value or 0

        data, counters = self.data, self.data.warning.number
        if len(counters) != N_WARNINGS or counters.strides != (8,):
            raise PlantError(
                f"mechatronic: MuJoCo {library.__version__} counts its warnings differently; use a"
                f" supported version."
            )
        # each counter follows the warning's info
        first = counters.ctypes.data - counters.itemsize
        a = Addresses.of(np.zeros(Addresses.n_words, dtype=np.int64))
        a.step = function("mj_step")
        a.set_state = function("mj_setState")
        a.get_state = function("mj_getState")
        a.copy_bytes = function("memcpy", ctypes.CDLL(None))
        a.model, a.memory = self.model._address, data._address
        a.sensors, a.warnings = data.sensordata.ctypes.data, first
        a.signature = signature
        before = signature & (int(library.mjtState.mjSTATE_XFRC_APPLIED) - 1)
        a.push = (
            library.mj_stateSize(self.model, before) + 6 * self.model.body("robot").id
        )
        return a

    def _initial(
        self, library: ModuleType, length: int, signature: int
    ) -> NDArray[np.float64]:
        numbers = np.zeros(MUJOCO + length)
        library.mj_getState(self.model, self.data, numbers[MUJOCO:], signature)
        place_body(self.parameters, numbers, 0.0, 0.0, 0.0)
        return numbers


_Handler = ctypes.CFUNCTYPE(None, ctypes.c_char_p)
_ignored = _Handler(lambda _: None)


def _silence(symbols: ctypes.CDLL) -> None:
    """Keep MuJoCo from writing MUJOCO_LOG.TXT to the working folder; we read its counters."""
    handler = ctypes.c_void_p.in_dll(symbols, "mju_user_warning")
    handler.value = ctypes.cast(_ignored, ctypes.c_void_p).value

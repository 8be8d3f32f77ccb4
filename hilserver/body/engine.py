"""MuJoCo itself: compiles the model and says where the kernel finds it. Nobody else imports it."""

import ctypes
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

import hilserver.body.layout as at
from hilserver.body.mjcf import mjcf
from hilserver.body.parameters import BodyParameters
from hilserver.body.step import place_body
from hilserver.plant.errors import PlantError

MISSING = "mechatronic.enabled: needs MuJoCo; install it with: pip install 'hilserver[physics]'."


def mujoco() -> ModuleType:
    """Return the library.

    Raises
    ------
    PlantError
        If it is not installed.
    """
    if find_spec("mujoco") is None:
        raise PlantError(MISSING)
    return import_module("mujoco")


class Engine:
    """One model and its data, to be stepped by whoever has its addresses; must outlive them.

    Attributes
    ----------
    body : BodyParameters
        What it was made from.
    parameters : ndarray of float64
        `p` of the kernel.
    initial : ndarray of float64
        `b` of the kernel: at rest in the origin.
    addresses : ndarray of int64
        `a` of the kernel, of this process.
    """

    def __init__(self, body: BodyParameters) -> None:
        library = mujoco()
        self.body = body
        self.model = library.MjModel.from_xml_string(mjcf(body, body.robot.solids))
        self.data = library.MjData(self.model)
        self.parameters = body.pack()
        signature = int(library.mjtState.mjSTATE_INTEGRATION)
        length = library.mj_stateSize(self.model, signature)
        self.addresses = self._addresses(library, signature)
        self.initial = self._initial(library, length, signature)

    @property
    def identity(self) -> bytes:
        """What two bodies must share for one to continue the other."""
        xml = mjcf(self.body, self.body.robot.solids)
        return xml.encode() + self.parameters.tobytes()

    def _addresses(self, library: ModuleType, signature: int) -> NDArray[np.int64]:
        (path,) = Path(library.__file__ or "").parent.glob("libmujoco.so*")
        symbols = ctypes.CDLL(str(path))  # the copy that the bindings have loaded
        _silence(symbols)

        def function(name: str, of: ctypes.CDLL = symbols) -> int:
            return ctypes.cast(getattr(of, name), ctypes.c_void_p).value or 0

        data, counters = self.data, self.data.warning.number
        if len(counters) != at.N_WARNINGS or counters.strides != (8,):
            raise PlantError(
                f"mechatronic: MuJoCo {library.__version__} counts warnings otherwise."
            )
        first = counters.ctypes.data - counters.itemsize  # what a warning was about stands before
        a = np.zeros(at.N_A, dtype=np.int64)
        a[at.A_STEP] = function("mj_step")
        a[at.A_SET_STATE] = function("mj_setState")
        a[at.A_GET_STATE] = function("mj_getState")
        a[at.A_COPY] = function("memcpy", ctypes.CDLL(None))
        a[at.A_MODEL], a[at.A_DATA] = self.model._address, data._address
        a[at.A_SENSORS], a[at.A_WARNINGS] = data.sensordata.ctypes.data, first
        a[at.A_SIGNATURE] = signature
        before = signature & (int(library.mjtState.mjSTATE_XFRC_APPLIED) - 1)
        a[at.A_PUSH] = library.mj_stateSize(self.model, before) + 6 * self.model.body("robot").id
        return a

    def _initial(self, library: ModuleType, length: int, signature: int) -> NDArray[np.float64]:
        b = np.zeros(at.B_MUJOCO + length)
        library.mj_getState(self.model, self.data, b[at.B_MUJOCO :], signature)
        place_body(self.parameters, b, 0.0, 0.0, 0.0)
        return b


_Handler = ctypes.CFUNCTYPE(None, ctypes.c_char_p)
_ignored = _Handler(lambda _: None)


def _silence(symbols: ctypes.CDLL) -> None:
    """Keep MuJoCo from writing MUJOCO_LOG.TXT into the working folder: we read its counters."""
    handler = ctypes.c_void_p.in_dll(symbols, "mju_user_warning")
    handler.value = ctypes.cast(_ignored, ctypes.c_void_p).value

"""The robot's parts as C that needs no Python: `python -m hilserver.fmu.machine_code FILE`.

Run it with `PORTABLE` in the environment: numba then compiles without vectors and without
instructions that some processor of the architecture lacks. The functions of numba used here are
private; a test fails when a version changes them.
"""

import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numba
from numba import types
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from hilserver.errors import FailedError
from hilserver.fmu.c_source import translate
from hilserver.plant.battery import battery_step
from hilserver.plant.carry_over import carry_over
from hilserver.plant.constants import compute
from hilserver.plant.imu import imu_step
from hilserver.plant.layout import INPUTS, OUTPUTS, PARAMETERS, STATE, STATUS
from hilserver.plant.nav import nav_step
from hilserver.plant.physical import FITS, Physical
from hilserver.plant.robot import robot_step
from hilserver.plant.shield import shield_step
from hilserver.plant.tof import tof_step

PARTS: Final = ("robot", "imu", "battery", "shield", "tof", "nav")
"""In the order of the numbers by which the C code selects them.

PACK computes the parameters from physical ones, CARRY adapts the state to new parameters.
"""
ROBOT, IMU, BATTERY, SHIELD, TOF, NAV, CARRY, PACK = range(len(PARTS) + 2)
ENTRY: Final = "hil_part"
PORTABLE: Final[Mapping[str, str]] = {
    "NUMBA_CPU_NAME": "generic",
    "NUMBA_CPU_FEATURES": "",
    "NUMBA_LOOP_VECTORIZE": "0",
}

_F8, _I8 = types.CPointer(types.float64), types.CPointer(types.int64)
_PHYSICAL: Final = Physical.layout
_SIGNATURE: Any = types.int64(types.int64, _F8, _F8, _F8, _F8, _I8, _F8, types.int64)


@intrinsic  # type: ignore[untyped-decorator]
def array_at(typing_context: Any, pointer: Any, length: Any) -> Any:
    """Return the array of `length` numbers at a pointer, without a reference count.

    `numba.carray` counts references, with atomic instructions that tie the code to a processor.
    """
    array = types.Array(pointer.dtype, 1, "C")

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        made = context.make_array(array)(context, builder)
        item = context.get_constant(types.intp, 8)
        populate_array(made, args[0], [args[1]], [item], item, None)
        return made._getvalue()

    return array(pointer, types.intp), generate


@intrinsic  # type: ignore[untyped-decorator]
def record(typing_context: Any, pointer: Any, layout: Any) -> Any:
    """Return the record of `layout` at a pointer."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.bitcast(args[0], context.get_value_type(signature.return_type))

    return layout.dtype(pointer, layout), generate


def run_part(
    which: int,
    p_at: Any,
    x_at: Any,
    u_at: Any,
    y_at: Any,
    q_at: Any,
    more_at: Any,
    n_more: int,
) -> int:
    """Run one part of the robot once, as a time slice of the daemon does.

    `more` are the walls, the new parameters, or the physical ones. Returns `FITS`, or why they do
    not fit.
    """
    p, x, u = record(p_at, PARAMETERS), record(x_at, STATE), record(u_at, INPUTS)
    y, q = record(y_at, OUTPUTS), record(q_at, STATUS)
    if which == ROBOT:
        robot_step(p, x, u, y, q)
    elif which == IMU:
        imu_step(p, x, u, y, q)
    elif which == BATTERY:
        battery_step(p, x, u, y, q)
    elif which == SHIELD:
        shield_step(p, x, u, y, q)
    elif which == TOF:
        tof_step(p, x, u, y, q, array_at(more_at, n_more))
    elif which == NAV:
        nav_step(p, x, u, y, q)
    elif which == CARRY:
        carry_over(p, record(more_at, PARAMETERS), x)
    elif which == PACK:
        return int(compute(record(more_at, _PHYSICAL), p))
    return FITS


def source() -> str:
    """Return the C source of `ENTRY` and of all functions that it calls.

    FailedError if this numba keeps its code elsewhere, or emits what has no equivalent in C.
    """
    compiled = numba.cfunc(_SIGNATURE, nopython=True, error_model="numpy", _nrt=False)(
        run_part
    )
    try:
        listing = str(compiled._library._final_module)
    except AttributeError as error:
        raise FailedError(
            f"numba {numba.__version__} does not expose its machine code ({error}); use numba 0.68"
        ) from None
    (kernel,) = re.findall(r"^define [^\n]*?@(\w*8run_part\w*)\(", listing, re.M)
    return translate(listing, kernel, ENTRY)


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(source(), encoding="utf-8")

"""The robot's parts as an object file that needs no Python: `python -m hilserver.fmu.machine_code`.

Run it with ``NUMBA_CPU_NAME=generic`` and ``NUMBA_CPU_FEATURES=``: the code then runs on every
processor of the architecture. What it calls of numba is private; a test says which version moved.
"""

import sys
from pathlib import Path
from typing import Any, Final

import numba
from llvmlite import binding
from numba import types
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from hilserver.errors import FailedError
from hilserver.plant.battery import battery_step
from hilserver.plant.carry_over import carry_over
from hilserver.plant.imu import imu_step
from hilserver.plant.layout import INPUTS, OUTPUTS, PARAMETERS, STATE, STATUS
from hilserver.plant.nav import nav_step
from hilserver.plant.robot import robot_step
from hilserver.plant.shield import shield_step
from hilserver.plant.tof import tof_step

PARTS: Final = ("robot", "imu", "battery", "shield", "tof", "nav")
"""By the number with which the C code asks for them; CARRY takes the state to other parameters."""
ROBOT, IMU, BATTERY, SHIELD, TOF, NAV, CARRY = range(len(PARTS) + 1)
ENTRY: Final = "hil_part"
TRIPLES: Final = {
    "x86_64-linux": ("x86_64-unknown-linux-gnu", "x86-64"),
    "aarch64-linux": ("aarch64-unknown-linux-gnu", "generic"),
    "x86_64-windows": ("x86_64-w64-windows-gnu", "x86-64"),
}

_F8, _I8 = types.CPointer(types.float64), types.CPointer(types.int64)
_SIGNATURE: Any = types.void(types.int64, _F8, _F8, _F8, _F8, _I8, _F8, types.int64)


@intrinsic  # type: ignore[untyped-decorator]
def array_at(typing_context: Any, pointer: Any, length: Any) -> Any:
    """Return the array of `length` numbers at a pointer; nobody counts its references.

    `numba.carray` does count them, with atomic instructions that bind the code to a processor.
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
    which: int, p_at: Any, x_at: Any, u_at: Any, y_at: Any, q_at: Any, more_at: Any, n_more: int
) -> None:
    """Run one part of the robot once, as a time slice of the daemon does.

    What is `more` are the walls, or the new parameters.
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


def emit(platform: str) -> bytes:
    """Return the object file for a platform, with the one function `ENTRY`.

    Raises
    ------
    FailedError
        If this numba keeps its code elsewhere.
    """
    try:
        compiled = numba.cfunc(_SIGNATURE, nopython=True, error_model="numpy", _nrt=False)(run_part)
        text = str(compiled._library._final_module)
        name = compiled._wrapper_name
    except AttributeError as error:
        raise FailedError(
            f"numba {numba.__version__} does not give its machine code away ({error}); use"
            " numba 0.68"
        ) from None
    triple, processor = TRIPLES[platform]
    module = binding.parse_assembly(text.replace(name, ENTRY))
    module.triple = triple
    binding.initialize_all_targets()
    binding.initialize_all_asmprinters()
    machine = binding.Target.from_triple(triple).create_target_machine(
        cpu=processor, features="", opt=3, reloc="pic", codemodel="small"
    )
    module.data_layout = str(machine.target_data)
    code: bytes = machine.emit_object(module)
    return code


if __name__ == "__main__":
    Path(sys.argv[2]).write_bytes(emit(sys.argv[1]))

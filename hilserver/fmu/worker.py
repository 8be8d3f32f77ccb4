"""The process of one FMU: `python -m hilserver.fmu.worker`, started by `process`."""

import contextlib
import gc
import mmap
import os
import pickle
import resource
import select
import sys
from typing import Final

import numpy as np

import hilserver.fmu.layout as at
from hilserver.fmu.exchange import answer
from hilserver.fmu.library import Instance
from hilserver.fmu.process import Order, Started, longest_silence_s
from hilserver.kernel.composition import Setting
from hilserver.plant.blocks import BlockError
from hilserver.program.workers import end_with_parent

_SELDOM_S: Final = 1.0  # how often it looks for a request whose bell did not ring


def main() -> int:
    """Start the FMU, report it, answer until the parent is gone."""
    order: Order = pickle.load(sys.stdin.buffer)  # noqa: S301 - of our own parent
    end_with_parent(order.parent)
    ready = os.fdopen(order.ready, "wb")
    try:
        instance = Instance(order.fmu, order.wiring, order.name, 0)
    except BlockError as error:
        with ready:
            pickle.dump(Started(str(error), np.zeros(0), 0, 0), ready)
        return 1
    x = instance.initial
    a = instance.addresses
    wiring = order.wiring
    u, p, y = (
        np.zeros(n) for n in (wiring.n_inputs, wiring.n_parameters, wiring.n_outputs)
    )
    first = at.N_SHARED + u.size + p.size
    store = x.size - at.X_BYTES
    n_words = first + y.size + 4 * store
    if order.is_first:
        os.ftruncate(order.memory, 8 * n_words)
    words = np.frombuffer(mmap.mmap(order.memory, 8 * n_words), dtype=np.int64)
    words[at.S_CURRENT] = order.is_first
    if order.is_first:
        words[first : first + y.size] = instance.outputs.view(np.int64)
        words[first + y.size :][:store] = x.view(np.int64)[at.X_BYTES :]
    with ready:
        pickle.dump(Started("", x, int(a[at.A_CAPACITY]), n_words), ready)
    message = words[at.S_MESSAGE : at.N_SHARED]
    _be_prompt(order.setting)
    while True:
        select.select([order.bell], [], [], _SELDOM_S)
        with contextlib.suppress(BlockingIOError):  # it did not ring
            os.eventfd_read(order.bell)
        while answer(words, u, y, x, p, a, order.setting.period_s):
            message[:] = instance.message_words


def _be_prompt(setting: Setting) -> None:
    """Run right behind the plant: an ordinary process could wait for its turn for many slices.

    A process that never sleeps would then keep others from its core; the kernel ends it (SIGXCPU)
    after the silence for which the plant gives it up. If the system does not grant this, it does
    not grant it to the plant's thread either, and the audit reports that.
    """
    gc.disable()  # nothing is left to collect
    others = os.sched_getaffinity(0) - {setting.plant_core}
    if others:
        os.sched_setaffinity(0, others)
    if setting.priority > 0:
        limit_us = round(1e6 * longest_silence_s(setting.period_s))
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        with contextlib.suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_RTTIME, (limit_us, 2 * limit_us))
            os.sched_setscheduler(0, policy, os.sched_param(setting.priority))


if __name__ == "__main__":
    sys.exit(main())

"""Models of others that a robot runs: every robot starts its own, and ends them."""

from contextlib import ExitStack
from dataclasses import replace

from hilserver.body.engine import Engine
from hilserver.daemon.assembly import Assembly
from hilserver.kernel import BlockUse
from hilserver.kernel.composition import Setting


def with_models(assembly: Assembly, *, waits: bool) -> Assembly:
    """Return an assembly whose models nobody else steps: the mechatronic one, and FMUs.

    Parameters
    ----------
    waits : bool
        Whether time waits for models in processes of their own: simulated time does.

    Raises
    ------
    ConfigError
        If an FMU does not start.
    """
    composition = assembly.composition
    body = None if composition.body is None else Engine(composition.body.body)
    with ExitStack() as begun:
        blocks = []
        for index, block in enumerate(composition.blocks):
            with assembly.at("blocks", index, "fmu"):
                blocks.append(_started(block, assembly, waits=waits))
            foreign = blocks[-1].foreign
            if foreign is not None:
                begun.callback(foreign.close)
        begun.pop_all()
    return replace(assembly, composition=replace(composition, body=body, blocks=blocks))


def end_models(assembly: Assembly) -> None:
    """End the FMUs of an assembly; nothing is paced any more."""
    for block in assembly.composition.blocks:
        if block.foreign is not None:
            block.foreign.close()


def _started(block: BlockUse, assembly: Assembly, *, waits: bool) -> BlockUse:
    if block.model is None:
        return block
    period_s = assembly.composition.periods_s[block.slice]
    setting = Setting(period_s, assembly.base_period_ns * 1e-9, waits)
    return replace(block, foreign=block.model.start(block.name, setting))

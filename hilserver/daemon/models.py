"""Models of others that a robot runs: every robot starts its own, and ends them."""

from contextlib import ExitStack
from dataclasses import replace

from hilserver.body.engine import Engine
from hilserver.daemon.assembly import Assembly
from hilserver.kernel import BlockUse
from hilserver.kernel.composition import Setting
from hilserver.scheduler import RealtimeSettings


def with_models(assembly: Assembly, plant: RealtimeSettings, *, waits: bool) -> Assembly:
    """Return an assembly whose models nobody else steps: the mechatronic one, and FMUs.

    Parameters
    ----------
    plant : RealtimeSettings
        What the plant's thread asks for: models in processes of their own come right behind it.
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
                blocks.append(_started(block, assembly, plant, waits=waits))
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


def _started(
    block: BlockUse, assembly: Assembly, plant: RealtimeSettings, *, waits: bool
) -> BlockUse:
    if block.model is None:
        return block
    period_s = assembly.composition.periods_s[block.slice]
    base_period_s, priority = assembly.base_period_ns * 1e-9, max(plant.priority - 1, 0)
    setting = Setting(period_s, base_period_s, waits, priority, plant.cpu)
    return replace(block, foreign=block.model.start(block.name, setting))

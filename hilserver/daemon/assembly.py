"""From a configuration to everything that is fixed before the first tick.

Signal table, slices, packed parameters, own blocks. `hilserver check` and the daemon both use
this, so that `run` can start what `check` accepts.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeVar

from hilserver.body.engine import BodyEngine
from hilserver.config.blocks import BlockConfig
from hilserver.config.loading import place
from hilserver.config.mechatronic import BODY_PERIOD_MS, DEFAULT_SLICE
from hilserver.config.observer import DEFAULT_PERIOD_MS as OBSERVER_PERIOD_MS
from hilserver.config.observer import DEFAULT_SLICE as OBSERVER_SLICE
from hilserver.config.observer import constants_of, load_found
from hilserver.config.patch import Patch, load_patch
from hilserver.config.peers import check_peers, check_signals
from hilserver.config.plant import check_apart, to_parameters
from hilserver.config.root import Config, load_config
from hilserver.config.ros2 import REAL_ROBOT
from hilserver.config.timing import COMMUNICATION_SLICES
from hilserver.daemon.assembled import Assembly
from hilserver.errors import ConfigError
from hilserver.kernel import BlockUse, Composition, RobotPart
from hilserver.kernel.composition import ForeignModel, ObserverUse
from hilserver.kernel.fitted import fitted_limits
from hilserver.parameters import PLANT, geometric_gain, read, table_of, with_values
from hilserver.parameters.table import BLOCK
from hilserver.plant.blocks import BlockDeclaration, load_block
from hilserver.plant.errors import PlantError
from hilserver.plant.layout import Parameters
from hilserver.plant.packing import initial_state, pack
from hilserver.plant.parameters import RobotParameters
from hilserver.scheduler.slices import Slice, period_in_ticks
from hilserver.signals import MEASURED, BlockOutput, Ranges, SignalTable, robot_table

__all__ = ["Assembly", "assemble", "assemble_config"]

T = TypeVar("T")
NS_PER_MS = 1_000_000
_ONE = {"inputs": "input", "parameters": "parameter", "drives": "output"}


def assemble(
    path: Path | None, patch: Path | None = None, group: str | None = None
) -> Assembly:
    """Load and check a configuration, and a patch over it, down to the last signal name.

    ConfigError has one sentence per complaint, with file, line and key.
    """
    laid_over = None if patch is None else load_patch(patch, group)
    return _AssemblyBuilder(load_config(path), path, laid_over).build()


def assemble_config(
    config: Config, folder: Path | None = None, patch: Patch | None = None
) -> Assembly:
    """Like `assemble`, for a configuration made in Python (tests, test kit)."""
    return _AssemblyBuilder(
        config, None if folder is None else folder / "config.yaml", patch
    ).build()


class _AssemblyBuilder:
    """Builds an `Assembly`; knows where in the file a complaint belongs."""

    def __init__(self, config: Config, path: Path | None, patch: Patch | None) -> None:
        self._config = config
        self._path = path
        self._patch = patch
        self._folder = Path.cwd() if path is None else path.resolve().parent

    def _fail(self, location: Sequence[str | int], message: str) -> ConfigError:
        return ConfigError(place(self._path, location) + message)

    def _checked(self, location: Sequence[str | int], make: Callable[[], T]) -> T:
        try:
            return make()
        except ValueError as error:
            raise self._fail(location, str(error)) from None

    def build(self) -> Assembly:
        config = self._config
        self._check_owner()
        self._check_names()
        base_ns = round(config.scheduler.base_period_ms * NS_PER_MS)
        slices = self._slices(base_ns)
        periods_s = {s.name: s.period_ticks * base_ns * 1e-9 for s in slices}
        parts = self._parts(slices)
        configured = robot = self.robot(periods_s)
        if self._patch is not None:
            configured = _AssemblyBuilder(config, self._path, None).robot(periods_s)
        blocks = [
            self._block(i, block, slices) for i, block in enumerate(config.blocks)
        ]
        outputs = [output for block in blocks for output in _outputs(block)]
        body, p = self._body(robot, periods_s), pack(robot)
        observer = self._observer(robot, p, slices)
        has = {"body": body is not None, "observer": observer is not None}
        has["samples"] = config.recalibration.enabled
        table = self._checked(
            ("blocks",), lambda: robot_table(Ranges(*robot.ranges), outputs, **has)
        )
        self._check_wiring(table, blocks)
        composition = Composition(
            table=table,
            slices=[s.name for s in slices if s.compiled],
            periods_s=periods_s,
            parts=parts,
            blocks=blocks,
            parameters=p,
            state=initial_state(robot),
            hall=robot.hall,
            fitted=fitted_limits(None if self._patch is None else self._patch.model),
            body=body,
            observer=observer,
            settings=_settings(config, robot, blocks),
        )
        return Assembly(
            config,
            config,
            self._path,
            robot,
            table,
            base_ns,
            slices,
            composition,
            configured,
            self._patch,
        )

    def _check_owner(self) -> None:
        config = self._config
        first = self._config.first_source
        if first not in config.control.priority:
            raise self._fail(("control",), f"source '{first}' is not in priority")
        if first not in config.sources:
            known = ", ".join(config.sources)
            here = ("control", "source")
            raise self._fail(here, f"there is no '{first}' here; sources are {known}")

    def _check_names(self) -> None:
        drivers = self._config.drivers
        taken = {
            o.name for o in drivers if o.is_enabled and o.source != f"peer:{o.name}"
        }
        if self._config.ros2.enabled and self._config.ros2.measured is not None:
            taken.add(REAL_ROBOT)
        for index, peer in enumerate(self._config.peers):
            if peer.name in taken:
                here = ("peers", index, "name")
                raise self._fail(
                    here,
                    f"a peer cannot be named '{peer.name}' while {peer.name} is enabled",
                )
        names = [block.name for block in self._config.blocks]
        for index, name in enumerate(names):
            if name in names[:index]:
                raise self._fail(
                    ("blocks", index, "name"), f"two blocks have the name '{name}'"
                )

    def robot(self, periods_s: Mapping[str, float]) -> RobotParameters:
        """Return the plant of the configuration, with the patch over it."""
        config = self._config
        plant = (
            config.plant if self._patch is None else self._patch.applied(config.plant)
        )
        own = {} if self._patch is None else self._patch.parameters
        try:
            robot = to_parameters(
                plant, config.kinematics, config.sensors, periods_s, self._folder
            )
            robot = replace(robot, body_wheels=config.mechatronic.turns_wheels)
            if own:
                robot = with_values(robot, own, geometric_gain(robot))
                pack(robot)  # refuses what does not fit the robot
            return robot
        except PlantError as error:
            key, _, rest = str(error).partition(": ")
            if (
                self._patch is not None
                and (entry := self._patch.entry_at(key)) is not None
            ):
                raise self._patch.refusal(entry, rest) from None
            cause = self._cause(periods_s) if key == "plant.slice" else None
            raise self._fail(cause or key.split("."), rest) from None

    def _cause(self, periods_s: Mapping[str, float]) -> Sequence[str] | None:
        """Return the key without which the wheel loop would be stable, if it is only one.

        The loop is refused at the slice whose period it does not stand, but whoever has given a
        gain looks for the mistake there.
        """
        plant = self._config.plant
        for name in ("controller", "process"):
            part = getattr(plant, name)
            fields = type(part).model_fields
            for key in sorted(part.model_fields_set):
                usual = {key: fields[key].default}
                tried = plant.changed(**{name: usual})
                try:
                    to_parameters(
                        tried,
                        self._config.kinematics,
                        self._config.sensors,
                        periods_s,
                        self._folder,
                    )
                except PlantError:
                    continue
                return ("plant", name, key)
        scheduler = self._config.scheduler
        given = scheduler.model_fields_set
        is_given = "slices" in given and plant.slice == "plant"
        return ("scheduler", "slices", plant.slice) if is_given else None

    def _body(
        self, robot: RobotParameters, periods_s: Mapping[str, float]
    ) -> BodyEngine | None:
        section = self._config.mechatronic
        if not section.enabled:
            return None
        try:
            check_apart(robot)
            return BodyEngine(section.body(robot, periods_s[section.slice]))
        except PlantError as error:
            key, _, rest = str(error).partition(": ")
            raise self._fail(key.split("."), rest) from None

    def _observer(
        self, robot: RobotParameters, p: Parameters, slices: Sequence[Slice]
    ) -> ObserverUse | None:
        section = self._config.observer
        sensors = self._config.sensors
        if not section.enabled:
            return None
        try:
            found = (
                None
                if section.noise is None
                else load_found(self._folder / section.noise)
            )
        except ConfigError as error:
            raise self._fail(("observer", "noise"), str(error)) from None
        try:
            c = constants_of(robot, found, section.readmit_after)
        except PlantError as error:
            raise self._fail(
                ("observer",), str(error).removeprefix("observer: ")
            ) from None
        ticks = {s.name: s.period_ticks for s in slices}
        return ObserverUse(
            section.source,
            c,
            p.copy(),
            ticks[sensors.nav.slice],
            ticks[sensors.imu.slice],
        )

    def _slices(self, base_ns: int) -> list[Slice]:
        slices: list[Slice] = []
        periods_ms = dict(self._config.scheduler.slices)
        mechatronic = self._config.mechatronic
        if mechatronic.enabled and mechatronic.slice == DEFAULT_SLICE:
            periods_ms.setdefault(DEFAULT_SLICE, BODY_PERIOD_MS)
        observer = self._config.observer
        if observer.enabled and observer.slice == OBSERVER_SLICE:
            periods_ms.setdefault(OBSERVER_SLICE, OBSERVER_PERIOD_MS)
        for name, period_ms in periods_ms.items():
            period_ns = round(period_ms * NS_PER_MS)
            make = partial(period_in_ticks, name, period_ns, base_ns)
            ticks = self._checked(("scheduler", "slices", name), make)
            slices.append(Slice(name, ticks, name not in COMMUNICATION_SLICES))
        first = self._config.plant.slice
        return sorted(slices, key=lambda s: (not s.compiled, s.name != first))

    def _parts(self, slices: Sequence[Slice]) -> list[RobotPart]:
        sensors = self._config.sensors
        self._need_compiled(("plant", "slice"), self._config.plant.slice, slices)
        body = self._config.mechatronic
        parts = [RobotPart("robot", self._config.plant.slice)]
        if body.turns_wheels:
            parts.insert(
                0, RobotPart("body_wheels", self._config.plant.slice, of_body=True)
            )
        for name in ("imu", "battery", "tof", "nav"):
            slice_name = getattr(sensors, name).slice
            self._need_compiled(("sensors", name, "slice"), slice_name, slices)
            of_body = (
                body.enabled
                and body.sensors == "body"
                and name in ("imu", "tof", "nav")
            )
            parts.append(RobotPart(name, slice_name, of_body))
            if name == "battery":
                parts.append(RobotPart("shield", slice_name))
        if body.enabled:
            self._need_compiled(("mechatronic", "slice"), body.slice, slices)
            parts.append(RobotPart("body", body.slice, of_body=True))
        if self._config.observer.enabled:
            self._need_compiled(
                ("observer", "slice"), self._config.observer.slice, slices
            )
            parts.append(RobotPart("observer", self._config.observer.slice))
        return parts

    def _need_compiled(
        self, location: Sequence[str | int], name: str, slices: Sequence[Slice]
    ) -> None:
        known = [s.name for s in slices if s.compiled]
        if name not in known:
            raise self._fail(
                location,
                f"there is no plant-side slice '{name}'; slices are {', '.join(known)}",
            )

    def _block(
        self, index: int, block: BlockConfig, slices: Sequence[Slice]
    ) -> BlockUse:
        here = ("blocks", index)
        self._need_compiled((*here, "slice"), block.slice, slices)
        declared, model = self._checked(
            (*here, "function" if block.fmu is None else "fmu"),
            lambda: self._declared(block),
        )
        missing = [name for name in declared.inputs if name not in block.inputs]
        if missing:
            raise self._fail(
                (*here, "inputs"), f"input '{missing[0]}' of the block is not wired"
            )
        for kind, given, known in (
            ("inputs", block.inputs, declared.inputs),
            ("parameters", block.parameters, declared.parameters),
            ("drives", block.drives, [output.name for output in declared.outputs]),
        ):
            for name in given:
                if name not in known:
                    raise self._fail(
                        (*here, kind, name),
                        f"the block has no {_ONE[kind]} '{name}'; known are {', '.join(known)}",
                    )
        return BlockUse(
            block.name,
            declared,
            block.slice,
            block.inputs,
            block.parameters,
            model=model,
            drives=block.drives,
        )

    def _declared(
        self, block: BlockConfig
    ) -> tuple[BlockDeclaration, ForeignModel | None]:
        if block.function is not None:
            return load_block(block.function, self._folder), None
        from hilserver.fmu.block import load_fmu_block  # noqa: PLC0415 -- compiled only where needed

        return load_fmu_block(
            str(block.fmu),
            self._folder,
            inputs=block.inputs,
            outputs=block.outputs,
            start=block.start,
            process=block.process,
        )

    def _check_wiring(self, table: SignalTable, blocks: Sequence[BlockUse]) -> None:
        for index, block in enumerate(blocks):
            for name, signal in block.inputs.items():
                if signal not in table or table[signal].is_array:
                    raise self._fail(
                        ("blocks", index, "inputs", name),
                        f"there is no scalar signal '{signal}'; see 'hilserver signals'",
                    )
            for name, signal in block.drives.items():
                is_command = signal in table and table.slot(signal) <= table.slot(
                    "drive.enable"
                )
                if not is_command or table[signal].is_array:
                    raise self._fail(
                        ("blocks", index, "drives", name),
                        f"'{signal}' is not a scalar set-point, control.mode or drive.enable; a"
                        f" block can command only these",
                    )
        for index, peer in enumerate(self._config.peers):
            for problem in check_signals(peer, table):
                raise self._fail(("peers", index, *problem.location), problem.message)
        for name in self._config.shadow.limits:
            if f"{MEASURED}{name}" not in table:
                raise self._fail(
                    ("shadow", "limits", name),
                    f"there is no measured value of '{name}'; 'hilserver signals' lists measured.*",
                )
        for problem in check_peers(list(self._config.peers)):
            raise self._fail(("peers", *problem.location), problem.message)


def _settings(
    config: Config, robot: RobotParameters, blocks: Sequence[BlockUse]
) -> dict[str, float]:
    """Return the value of every parameter; those of the body come from the configuration."""
    values = read(robot)
    body = config.mechatronic.model_dump()
    for name in PLANT.keys() - values.keys():
        inner = body["tyre"] if name.startswith("mechatronic.tyre.") else body
        values[name] = inner[name.rpartition(".")[2]]
    for block in blocks:
        own = zip(block.declaration.parameters, block.values, strict=True)
        values |= {f"{BLOCK}{block.name}.{key}": value for key, value in own}
    return {
        name: values[name] for name in table_of((b.name, b.declaration) for b in blocks)
    }


def _outputs(block: BlockUse) -> list[BlockOutput]:
    return [
        BlockOutput(
            block.output_signal(o.name),
            o.unit,
            o.low,
            o.high,
            o.description,
            o.is_replayed,
        )
        for o in block.declaration.outputs
    ]

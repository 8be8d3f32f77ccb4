"""Parameters that change while it runs: at one tick, with the state carried over, or not at all."""

import asyncio
import math
from fnmatch import fnmatchcase

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilserver.config.root import Config
from hilserver.core.refusal import Refusal
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.builder import build
from hilserver.errors import ControlRefused
from hilserver.image import Row
from hilserver.image.changes import MOST_WAITING
from hilserver.parameters import PLANT
from hilserver.plant.terms import TERMS
from hilserver.signals import Direction

AT_A_TICK = [name for name, p in PLANT.items() if p.when == "tick"]
WITHOUT_REFERENCE = {"backlash": 0.02, "body_lag": 0.05, "acceleration_slip": 0.01}
TERMS_ON = {n: t.reference for n, t in TERMS.items() if t.reference} | WITHOUT_REFERENCE
AT_LIMIT = {"controller": {"limit_pct": 40.0}}
"""The duties of the left wheels are limited all through the turn: anti-windup is at work."""
PLANTS = {"base": {}, "with terms": {"terms": TERMS_ON}, "at the limit": AT_LIMIT}
TURN = {"wheel.fl": 60, "wheel.rl": 55, "wheel.fr": -10, "wheel.rr": -15}
MOVING_TICKS = 150
"""A multiple of every slice, so that all sensors show their values in the tick of the change."""


def config_of(plant):
    data = {
        "scheduler": {"backend": "virtual"},
        "sensors": {"nav": {"enabled": True}},
        "plant": plant,
    }
    return Config.model_validate(data)


@pytest.fixture(scope="module", params=PLANTS)
def moving(request, tmp_path_factory):
    """A core, and its state in the middle of a turn that begins."""
    folder, loop = tmp_path_factory.mktemp("moving"), asyncio.new_event_loop()
    core = build(assemble_config(config_of(PLANTS[request.param]), folder))
    loop.run_until_complete(core.__aenter__())
    core.image.control.state = 1
    assert core.image.push(
        Row(core.table.slot(f"{n}.setpoint_rpm"), v) for n, v in TURN.items()
    )
    loop.run_until_complete(core.scheduler.advance(MOVING_TICKS))
    loop.run_until_complete(core.snapshots.capture())
    yield Moving(core, loop, core.image.shadow.copy())
    loop.run_until_complete(core.__aexit__())
    loop.close()


class Moving:
    """Goes on from the middle of the turn, as often as one likes."""

    def __init__(self, core, loop, state):
        self.core, self.loop, self.state = core, loop, state
        self.names = [
            s.name for s in core.table.scalars if s.direction is Direction.OUT
        ]
        self.slots = [core.table.slot(name) for name in self.names]

    def go_on(self, values=None, ticks=1):
        """Return the outputs of the next tick, after a change if there is one."""
        self.loop.run_until_complete(
            self.core.snapshots.restore(self.state, MOVING_TICKS)
        )
        if values:
            assert self.core.parameters.write("test", values) == {}
        self.loop.run_until_complete(self.core.scheduler.advance(1))
        found = self.core.image.latest().values[self.slots].copy()
        if ticks > 1:
            self.loop.run_until_complete(self.core.scheduler.advance(ticks - 1))
        return found

    def others(self, name):
        """Return values that the parameter can have beside the present one."""
        p, now = PLANT[name], self.core.parameters.values[name]
        term = TERMS.get(name.removeprefix("terms."))
        wanted = [p.default, 1.0, term.reference if term else None]
        if math.isfinite(now):
            wanted += [now * 1.2, now * 0.5, now + 0.05 * min(p.high - now, 1.0), -now]
        for value in dict.fromkeys(v for v in wanted if v is not None):
            if value == now or (math.isnan(value) and math.isnan(now)):
                continue
            if self.core.parameters.write("test", {name: value}) == {}:
                yield value
                self.loop.run_until_complete(
                    self.core.snapshots.restore(self.state, MOVING_TICKS)
                )


@pytest.mark.parametrize("name", AT_A_TICK)
def test_nothing_jumps_but_what_the_table_says(moving, name):
    before, tried = moving.go_on(), 0
    for value in list(moving.others(name)):
        after, tried = moving.go_on({name: value}, ticks=200), tried + 1
        jumped = np.abs(after - before) > 1e-9 * np.maximum(1.0, np.abs(before))
        allowed = ("internal.edition", *PLANT[name].outputs)
        wrong = [
            (signal, float(a), float(b))
            for signal, a, b, jump in zip(
                moving.names, before, after, jumped, strict=True
            )
            if jump and not any(fnmatchcase(signal, pattern) for pattern in allowed)
        ]
        assert not wrong, f"{name} = {value}"
        assert np.isfinite(moving.core.image.latest().values).all(), f"{name} = {value}"
    assert tried or name == "terms.roller_slip"  # of mecanum wheels


def test_at_the_limit_anti_windup_is_at_work(moving):
    duties = moving.go_on()[[moving.names.index(f"{name}.duty_pct") for name in TURN]]
    limited = moving.core.assembly.robot.controller.limit_pct == 40.0
    assert (abs(duties) == 40.0).tolist() == [limited, limited, False, False]


@settings(max_examples=30, deadline=None)
@given(st.data())
def test_writing_what_is_in_force_changes_no_bit(moving, data):
    name = data.draw(st.sampled_from(AT_A_TICK))
    before = moving.go_on(ticks=50)
    last = moving.core.image.latest().values[moving.slots].copy()
    after = moving.go_on({name: moving.core.parameters.values[name]}, ticks=50)
    edition = moving.names.index("internal.edition")
    before[edition] = after[edition] = 0.0
    assert before.tobytes() == after.tobytes()
    now = moving.core.image.latest().values[moving.slots].copy()
    now[edition] = last[edition]
    assert now.tobytes() == last.tobytes()


HOSTILE = [
    math.nan,
    math.inf,
    -math.inf,
    1e308,
    -1e308,
    None,
    "1",
    True,
    [1.0, 2.0],
    b"",
    10**400,
]


@pytest.fixture
async def core(tmp_path):
    async with build(assemble_config(config_of({}), tmp_path)) as made:
        made.image.control.state = 1
        yield made


async def test_hostile_values_change_nothing_and_get_a_sentence_each(core):
    live = core.image.region("p")[0].copy()
    values = dict(core.parameters.values)
    names = [n for n, p in PLANT.items() if not p.nullable and not p.is_flag]
    tried = 0
    for name in [*names, "bogus", "parameters.plant.max_rpm", "terms.bogus", ""]:
        for value in HOSTILE:
            refused = core.parameters.write("test", {name: value})
            assert list(refused) == [name]
            assert refused[name].text.endswith((".", "'?"))
            tried += 1
    await core.scheduler.advance(1)
    assert tried > 300
    assert core.parameters.values == pytest.approx(values, nan_ok=True)
    assert np.array_equal(core.image.region("p")[0], live)
    assert core.image.region("edition")[0][0] == 0
    assert "refused: " in core.events.recent[-1].message


async def test_what_does_not_fit_together_is_refused_as_a_whole(core):
    unstable = {"plant.controller.k_p": 1000.0, "terms.rotation_gain": 0.1}
    refused = core.parameters.write("test", unstable)
    assert set(refused) == set(unstable)
    assert "unstable" in refused["terms.rotation_gain"].text
    assert core.parameters.differing == {}
    # neither would do alone
    fitting = {"plant.wheelbase_m": 0.03, "plant.icr_offset_m": 0.01}
    assert core.parameters.write("test", {"plant.wheelbase_m": 0.03}) != {}
    assert core.parameters.write("test", fitting) == {}
    assert core.parameters.differing == fitting


async def test_all_values_of_a_write_act_in_one_tick_and_reset_goes_back(core):
    slot = core.table.slot("internal.edition")
    await core.scheduler.advance(10)
    both = {"plant.controller.k_p": 14.0, "terms.body_lag": 0.1}
    assert core.parameters.write("test", both) == {}
    await core.scheduler.advance(1)
    p = core.image.region("p")[0].copy()
    assert core.image.latest().values[slot] == 1
    tick = await core.parameters.taken(core.parameters.reset())
    assert (tick, core.parameters.differing) == (11, {})
    await core.scheduler.advance(1)
    assert not np.array_equal(core.image.region("p")[0], p)


async def test_more_than_the_plant_takes_is_refused(core):
    for step in range(MOST_WAITING):
        core.parameters.apply({"plant.controller.k_p": 10.0 + step})
    with pytest.raises(ControlRefused, match="has not applied the last changes"):
        core.parameters.apply({"plant.controller.k_p": 9.0})
    await core.scheduler.advance(1)
    assert core.parameters.values["plant.controller.k_p"] == 10.0 + MOST_WAITING - 1


async def test_a_snapshot_brings_its_parameters_and_a_reset_keeps_those_of_now(core):
    core.parameters.apply({"terms.rotation_gain": -0.3})
    await core.scheduler.advance(20)
    await core.snapshots.save("turning")
    core.parameters.apply({"terms.rotation_gain": 0.2, "plant.max_rpm": 50.0})
    await core.scheduler.advance(20)
    p = core.image.region("p")[0].copy()
    core.snapshots.reset()
    await core.scheduler.advance(1)
    assert np.array_equal(core.image.region("p")[0], p)
    await core.snapshots.load("turning")
    assert core.parameters.differing == {"terms.rotation_gain": -0.3}
    core.parameters.apply({"plant.controller.k_p": 14.0})
    await core.scheduler.advance(1)
    assert core.parameters.values["terms.rotation_gain"] == -0.3
    core.snapshots.reset()
    await core.scheduler.advance(1)
    assert core.image.region("parameters")[0].tolist() == pytest.approx(
        list(core.parameters.values.values()), nan_ok=True
    )


async def test_what_is_scheduled_acts_at_its_tick(core):
    slot = core.table.slot("internal.edition")
    core.parameters.schedule(
        [(5, {"plant.max_rpm": 50.0}), (8, {"plant.max_rpm": 60.0})]
    )
    core.parameters.look_ahead(20)
    editions = []
    for _ in range(10):
        await core.scheduler.advance(1)
        editions.append(core.image.latest().values[slot])
    assert editions == [0] * 5 + [1] * 3 + [2] * 2


def test_what_only_a_restart_changes_is_not_writable_and_a_wrong_value_out_of_range(
    moving,
):
    parameters = moving.core.parameters
    fixed = next(n for n, known in parameters.table.items() if known.when == "restart")
    refused = parameters.write("opcua", {fixed: 1.0, "plant.max_rpm": -1.0})
    assert refused[fixed].reason is Refusal.NOT_WRITABLE
    assert refused["plant.max_rpm"].reason is Refusal.OUT_OF_RANGE

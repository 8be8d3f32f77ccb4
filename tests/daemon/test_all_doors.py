"""A thousand changes of parameters over every door while it drives in real time."""

import asyncio
import json
import random

import numpy as np
import pytest
from asyncua import ua

from hilserver.errors import UserError
from hilserver.io.page.hand import Hand, RefusedError
from hilserver.io.page.setup import OpcUaAccess
from hilserver.testing.hil import HilError
from hilserver.testing.opening import open_hil
from tests.core.test_parameters import AT_A_TICK, TURN
from tests.io.opcua_server.rig import RobotClient
from tests.io.ros2.test_parameters import DOUBLE, Asker, parameters, value
from tests.replay.test_parameters import random_value, replayed

pytestmark = pytest.mark.long
CHANGES, DRIVE_EVERY = 1000, 20
DOORS = ("opcua", "page", "ros2", "kit", "scenario", "patch")
CONFIG = {
    "opcua": {"endpoint": "opc.tcp://127.0.0.1:0/hilserver"},
    "control": {"source": "scenario"},
    "sensors": {"nav": {"enabled": True}},
}


class Doors:
    """Each changes parameters in its way, and returns whether that was accepted."""

    def __init__(self, kit, folder, client, hand):
        self._kit, self._folder, self._client, self._hand = kit, folder, client, hand
        self._ask = Asker(kit.daemon.core)
        self._n = 0

    async def opcua(self, values):
        rows = (
            (f"parameters.{n}", float(v), ua.VariantType.Double)
            for n, v in values.items()
        )
        return all(code == "Good" for code in await self._client.write(*rows))

    async def page(self, values):
        try:
            await self._hand.write(
                {f"parameters.{n}": float(v) for n, v in values.items()}
            )
        except RefusedError:
            return False
        return True

    async def ros2(self, values):
        named = {n: value(DOUBLE, v) for n, v in values.items()}
        results = self._ask("set_parameters", **parameters(**named)).results
        return all(result.successful for result in results)

    async def kit(self, values):
        (name, number), *_ = values.items()
        try:
            await self._kit.set_parameter(name, number)
        except HilError:
            return False
        return True

    async def scenario(self, values):
        self._n += 1
        name, files = f"set-{self._n}.yaml", self._kit.daemon.desk
        steps = [{"at_s": 0.05, "set": values}]
        (self._folder / "scenarios" / name).write_text(json.dumps({"steps": steps}))
        try:
            await files.scenarios.start(name)
        except UserError:
            return False
        await self._kit.step(200)
        files.scenarios.stop()
        return True

    async def patch(self, values):
        files = self._kit.daemon.desk
        self._n += 1
        name = f"saved{self._n}"
        try:
            await files.patches.save(name)
            await files.patches.load(f"{name}.yaml")
        except UserError:
            return False
        return True


async def test_a_thousand_changes_over_every_door_come_again_to_the_bit(tmp_path):
    for name in ("scenarios", "patches"):
        (tmp_path / name).mkdir()
    recording = tmp_path / "run.mcap"
    folders = {name: str(tmp_path / name) for name in ("scenarios", "patches")}
    config = CONFIG | {"folders": folders, "recording": {"file": str(recording)}}
    rng, accepted = random.Random(39), dict.fromkeys(DOORS, 0)
    async with open_hil(config, "realtime") as kit:
        url = kit.daemon.part("opcua").url
        client = RobotClient(url)
        types = {f"parameters.{name}": "Double" for name in AT_A_TICK}
        hand = Hand(OpcUaAccess(url, "page"), types)
        await client.connect()
        await hand.connect()
        doors = Doors(kit, tmp_path, client, hand)
        try:
            for n in range(CHANGES):
                if n % DRIVE_EVERY == 0:
                    speeds = {
                        w: rpm * rng.choice([-1, 0, 1, 1]) for w, rpm in TURN.items()
                    }
                    kit.write({f"{w}.setpoint_rpm": rpm for w, rpm in speeds.items()})
                names = rng.sample(AT_A_TICK, rng.choice([1, 1, 3]))
                values = {name: random_value(name, rng) for name in names}
                rare = n % 50 == 49
                door = (
                    rng.choice(("scenario", "patch")) if rare else rng.choice(DOORS[:4])
                )
                accepted[door] += await getattr(doors, door)(values)
                await asyncio.sleep(0.02)
        finally:
            await hand.close()
            await client.disconnect()
    log, compared, _ = await replayed(recording)
    assert compared.difference is None
    assert all(accepted.values()), accepted
    assert len(log.changes) > CHANGES / 3
    assert np.ptp(log.columns["pose.yaw_rad"]) > 0.1, "it has driven"

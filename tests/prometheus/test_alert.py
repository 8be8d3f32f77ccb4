"""An alert from end to end: Node-RED is killed and Prometheus notices; it is back, it clears."""

import pytest

from tests.node_red.node_red import shipped_flow
from tests.prometheus.rig import running_rig
from tests.prometheus.server import missing, until

pytestmark = [pytest.mark.prometheus, pytest.mark.node_red]

FOR_S = 5
"""`for` of HilserverPeerLost."""


async def test_a_lost_peer_fires_and_clears(node_red, tmp_path) -> None:
    if sentence := missing():
        pytest.fail(sentence, pytrace=False)
    async with running_rig(node_red(shipped_flow()), tmp_path) as rig:
        alerts = rig.prometheus.alerts

        def is_safe() -> bool:
            return alerts().get("HilserverSafeState") == "firing"

        # a busy computer raises others
        watched = {"HilserverPeerLost", "HilserverSafeState"}
        await until(
            lambda: not watched & alerts().keys(), 120, "the alerts of the start clear"
        )
        await rig.peer.kill()
        fired_s = await until(
            lambda: alerts().get("HilserverPeerLost") == "firing",
            120,
            "the alert fires",
        )
        assert fired_s >= FOR_S
        await until(is_safe, 120, "so does that of the safe state")
        await rig.peer.start()
        await until(
            lambda: "HilserverPeerLost" not in alerts(), 120, "the alert clears"
        )
        # The safe state is acknowledged by a person, and its alert stays until then.
        await until(is_safe, 120, "the alert of the safe state stays")
        await until(lambda: rig.is_fresh, 120, "the peer delivers again")
        rig.daemon.control.reset()
        await until(
            lambda: "HilserverSafeState" not in alerts(),
            120,
            "the safe state's alert clears",
        )

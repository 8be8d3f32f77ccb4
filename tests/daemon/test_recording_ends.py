"""A recording that cannot go on reaches whoever watches, in real time and in virtual time."""

import asyncio

import pytest

from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from tests.loopback.rig import configuration

SMALL = {"file": "run.csv", "max_mb": 1}


@pytest.mark.parametrize("backend", ["thread", "virtual"])
async def test_the_end_of_the_daemons_own_recording_is_an_event(tmp_path, backend):
    """Before, it was a line of the log at best, in virtual time not before the end."""
    config = configuration(recording=SMALL, scheduler={"backend": backend})
    async with Daemon(assemble_config(config, tmp_path)) as daemon:
        ended = []
        async with asyncio.timeout(120):
            while not ended:
                await daemon.wait(1.0)
                ended = [e for e in daemon.events.recent if e.source == "recording"]
        (event,) = ended
        assert event.severity == 700
        assert "run.csv: the recording has ended at " in event.message
        assert "task" not in event.message

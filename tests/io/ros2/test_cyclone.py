"""Against Cyclone DDS in C, with types made by its own compiler: topics both ways, a service."""

import asyncio
import shutil
import subprocess

import pytest

from tests.io.ros2.rig import HERE, PATIENCE_S, robot, value


@pytest.fixture(scope="session")
def cyclone(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cyclone")
    shutil.copy(HERE / "cyclone_peer_types.idl", folder / "types.idl")
    subprocess.run(["idlc", "types.idl"], cwd=folder, check=True)
    source, program = HERE / "cyclone_peer.c", folder / "cyclone_peer"
    command = ["cc", "-O0", "-I.", source, "types.c", "-o", program, "-lddsc"]
    subprocess.run(command, cwd=folder, check=True)
    return program


async def test_it_drives_reads_and_gets_the_answer_of_a_service(cyclone, domain):
    async with robot(domain, rmw="cyclonedds") as daemon:
        host = await asyncio.create_subprocess_exec(
            cyclone, str(domain), stdout=asyncio.subprocess.PIPE
        )
        said, _ = await asyncio.wait_for(host.communicate(), 2 * PATIENCE_S)
        assert host.returncode == 0, said
        assert value(daemon, "drive.enable") == 0.0

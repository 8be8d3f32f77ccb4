"""The databus as a client sees it that knows the metadata alone; a real broker, killed and back."""

import asyncio
import gc
import re
import subprocess
from contextlib import asynccontextmanager

import pytest

from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.errors import ConfigError
from hilserver.io.edge.link import EdgeLink
from hilserver.io.link_status import LinkState
from tests.io.edge.rig import Reader, broker, free_port
from tests.loopback.rig import configuration, wait_until

METADATA, STATUS = "ie/m/j/simatic/v1/agv/dp", "ie/s/j/simatic/v1/agv/status"
DRIVE = ["wheel.*.setpoint_rpm", "control.mode"]
GROUPS = [
    {"name": "wheels", "signals": ["wheel.*.speed_rpm", "sim.tick"], "rate_hz": 50},
    {"name": "drive", "signals": DRIVE, "rate_hz": 2, "writable": True},
]


@asynccontextmanager
async def daemon_at(port, folder, **settings):
    section = {
        "enabled": True,
        "host": "127.0.0.1",
        "port": port,
        "id": "agv",
        "groups": GROUPS,
    }
    edge = section | settings
    config = configuration(edge=edge, opcua={"enabled": False}, page={"enabled": False})
    async with Daemon(assemble_config(config, folder)) as daemon:
        yield daemon


@asynccontextmanager
async def reading(port):
    reader = Reader(port)
    reader.subscribe(METADATA)
    try:
        described = await reader.next(METADATA)
        reader.subscribe("ie/d/#")
        yield reader, described
    finally:
        reader.close()


def points(collection):
    return {p["name"]: p for p in collection["dataPointDefinitions"]}


async def test_the_metadata_alone_say_how_to_read_and_to_drive(tmp_path):
    port = free_port()
    with broker(tmp_path, port, "allow_anonymous true"):
        async with (
            daemon_at(port, tmp_path, qos=1) as daemon,
            reading(port) as (reader, described),
        ):
            (connection,) = described["connections"]
            wheels, drive = connection["dataPoints"]
            assert (wheels["publishType"], wheels.get("pubTopic")) == ("bulk", None)
            known = points(wheels)
            assert known["wheel.fl.speed_rpm"]["dataType"] == "LReal"
            assert known["sim.tick"]["dataType"] == "LInt"
            reader.subscribe(described["statustopic"])
            assert (await reader.next(STATUS))["connector"] == {"status": "available"}

            setpoints = {
                n: p["id"] for n, p in points(drive).items() if n.startswith("wheel")
            }
            assert len(setpoints) == 4

            async def turns():
                side = {"fl": 30.0, "rl": 30.0, "fr": -30.0, "rr": -30}
                values = [
                    (i, side[name.split(".")[1]]) for name, i in setpoints.items()
                ]
                reader.write(drive["pubTopic"], *values)
                message = await reader.next(wheels["topic"])
                values = {point["id"]: point for point in message["vals"]}
                tick = values[known["sim.tick"]["id"]]
                assert isinstance(tick["val"], str)
                assert re.fullmatch(
                    r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z", tick["ts"]
                )
                speed = values[known["wheel.fl.speed_rpm"]["id"]]
                return speed["val"] > 20 and speed["qc"] == 3

            await wait_until(turns)
            assert daemon.gate.owner == "peer"
            assert daemon.part("edge").status.state is LinkState.CONNECTED


@pytest.mark.parametrize(
    "count", [10_000, pytest.param(100_000, marks=pytest.mark.long)]
)
async def test_malformed_writes_lose_nothing(tmp_path, count):
    port = free_port()
    bad = [
        b"", b"{", b"[" * 5000, b'{"a":' * 5000, b"\xff", b"[]",
        b'{"vals":1}', b'{"vals":[1]}', b'{"vals":[{}]}',
        b'{"vals":[{"id":"9999","val":1}]}', b'{"vals":[{"id":[],"val":1}]}', b"x" * 70_000,
    ]  # fmt: skip
    with broker(tmp_path, port, "allow_anonymous true", "max_queued_messages 0"):
        async with (
            daemon_at(port, tmp_path) as daemon,
            reading(port) as (reader, described),
        ):
            status = daemon.part("edge").status
            drive = described["connections"][0]["dataPoints"][1]
            target = points(drive)["wheel.fl.setpoint_rpm"]["id"]
            reader.flood(drive["pubTopic"], (bad[i % len(bad)] for i in range(count)))
            await wait_until(lambda: status.fault_counts["bad_write"] == count, 600)
            for wrong in ("fast", True, None, 1e9, [1.0], {"a": 1}):
                reader.write(drive["pubTopic"], (target, wrong))
            await wait_until(lambda: status.fault_counts["refused_value"] == 6)
            reader.write(drive["pubTopic"], (target, 12.5))
            slot = daemon.table.slot("wheel.fl.setpoint_rpm")
            await wait_until(lambda: daemon.image.frame_values[slot] == 12.5)
            assert len(status.faults) <= 2


async def test_what_the_broker_has_kept_does_not_drive(tmp_path):
    port = free_port()
    with broker(tmp_path, port, "allow_anonymous true"):
        async with daemon_at(port, tmp_path), reading(port) as (reader, described):
            drive = described["connections"][0]["dataPoints"][1]
            target = points(drive)["wheel.fl.setpoint_rpm"]["id"]
        async with reading(port) as (reader, _):
            reader.write(drive["pubTopic"], (target, 33.0), retain=True)
            async with daemon_at(port, tmp_path) as daemon:
                status = daemon.part("edge").status
                slot = daemon.table.slot("wheel.fl.setpoint_rpm")
                await wait_until(lambda: status.fault_counts["bad_write"] == 1)
                assert "publish writes without retain" in str(status.faults)
                assert status.stale, "nobody has written"

                async def drives():
                    reader.write(drive["pubTopic"], (target, 12.5), retain=True)
                    return daemon.image.frame_values[slot] == 12.5

                await wait_until(drives)
                assert status.fault_counts["bad_write"] == 1, (
                    "what comes as it is written drives"
                )


async def test_a_broker_that_is_killed_and_comes_back_gets_the_newest_values(tmp_path):
    port = free_port()
    async with daemon_at(port, tmp_path) as daemon:
        link = daemon.part("edge")
        await wait_until(lambda: "no_broker:broker" in link.status.faults)
        with broker(tmp_path, port, "allow_anonymous true"):
            await wait_until(lambda: link.status.connected)
            async with reading(port) as (reader, _):
                reader.subscribe(STATUS)
                assert (await reader.next(STATUS))["connector"]["status"] == "available"
        await wait_until(lambda: not link.status.connected)
        tick = daemon.scheduler.tick
        await wait_until(lambda: daemon.scheduler.tick > tick + 500)
        assert len(link._waiting) <= len(GROUPS)
        with broker(tmp_path, port, "allow_anonymous true"):
            async with reading(port) as (reader, described):
                wheels = described["connections"][0]["dataPoints"][0]
                message = await reader.next(wheels["topic"])
                number = points(wheels)["sim.tick"]["id"]
                (first,) = (int(p["val"]) for p in message["vals"] if p["id"] == number)
                assert first > tick + 400
        assert link.status.reconnects == 1
        assert link.status.faults == {} or not link.status.connected


async def is_unavailable(port):
    """Wait until the broker says that the daemon is gone."""
    reader = Reader(port)
    reader.subscribe(STATUS)
    while (await reader.next(STATUS))["connector"]["status"] != "unavailable":
        pass
    reader.close()


async def test_the_last_will_speaks_for_a_daemon_that_is_gone(tmp_path):
    port = free_port()
    with broker(tmp_path, port, "allow_anonymous true"):
        async with daemon_at(port, tmp_path), reading(port):
            pass
        await is_unavailable(port)


async def _never(*_, **__):
    await asyncio.Event().wait()


async def _not_at_once(*_):
    """Wait as a library does that swallows one cancellation."""
    try:
        await _never()
    except asyncio.CancelledError:
        await _never()


async def test_the_last_will_speaks_where_we_cannot(tmp_path, monkeypatch):
    port = free_port()
    with broker(tmp_path, port, "allow_anonymous true"):
        async with daemon_at(port, tmp_path) as daemon:
            link = daemon.part("edge")
            await wait_until(lambda: link.status.connected)
            monkeypatch.setattr(link, "_say", _never)
        await is_unavailable(port)


async def test_the_last_will_speaks_where_the_connection_does_not_end(
    tmp_path, monkeypatch
):
    port = free_port()
    monkeypatch.setattr(EdgeLink, "_send", _not_at_once)
    with broker(tmp_path, port, "allow_anonymous true"):
        async with daemon_at(port, tmp_path) as daemon:
            link = daemon.part("edge")
            await wait_until(lambda: link.status.connected)
        await is_unavailable(port)


@pytest.mark.parametrize("trusted", [True, False])
async def test_a_broker_is_known_by_its_certificate_and_we_by_our_password(
    tmp_path, trusted
):
    make_secrets(tmp_path)
    port, plain = free_port(), free_port()
    tls = [f"certfile {tmp_path}/broker.pem", f"keyfile {tmp_path}/broker.key"]
    access = [f"password_file {tmp_path}/users", f"listener {plain} 127.0.0.1"]
    with broker(tmp_path, port, *tls, *access, "allow_anonymous false"):
        ca = "broker.pem" if trusted else "stranger.pem"
        settings = {"tls": {"ca": ca}, "user": "agv", "password_file": "password"}
        async with daemon_at(port, tmp_path, version="5", **settings) as daemon:
            status = daemon.part("edge").status
            if trusted:
                await wait_until(lambda: status.writes > 3)
            else:
                await wait_until(lambda: status.failed_attempts > 1)
                assert "certificate verify failed" in status.last_error
                assert not status.writes
    gc.collect()  # a socket that nobody has closed is a warning


def make_secrets(folder):
    for name in ("broker", "stranger"):
        make_certificate(folder, name)
    (folder / "password").write_text("a secret\n")
    words = ["mosquitto_passwd", "-b", "-c", folder / "users", "agv", "a secret"]
    subprocess.run(words, check=True)


def make_certificate(folder, name):
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2",
         "-keyout", f"{name}.key", "-out", f"{name}.pem", "-subj", f"/CN={name}",
         "-addext", "subjectAltName=IP:127.0.0.1"],
        cwd=folder, check=True, capture_output=True,
    )  # fmt: skip


def test_a_pattern_that_fits_nothing_is_named(tmp_path):
    groups = [{"name": "a", "signals": ["wheel.*.speed"]}]
    config = configuration(
        edge={"enabled": True, "groups": groups}, opcua={"enabled": False}
    )
    with pytest.raises(
        ConfigError, match=r"edge.*: group 'a': no signal matches 'wheel\.\*\.speed'"
    ):
        Daemon(assemble_config(config, tmp_path))

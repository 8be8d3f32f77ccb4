"""Logs that come in over the page: whole or not at all, and never over one that is there."""

import asyncio
import contextlib

import aiohttp
import pytest
from aiohttp import web
from aiohttp.test_utils import TestClient, TestServer

from hilserver.io.page import uploads as module
from hilserver.io.page.hand import RefusedError
from hilserver.io.page.uploads import Uploads


@pytest.fixture
async def send(tmp_path):
    uploads = Uploads(tmp_path / "logs")

    async def take(request):
        try:
            return web.json_response(
                await uploads.take(request.match_info["name"], request)
            )
        except RefusedError as error:
            return web.json_response(str(error), status=409)

    application = web.Application()
    application.add_routes([web.post("/{name}", take)])
    async with TestClient(TestServer(application)) as client:

        async def send(name, data):
            async with client.post(f"/{name}", data=data) as response:
                return response.status, await response.json()

        yield send
    assert not list((tmp_path / "logs").glob(".*"))


async def test_a_log_comes_in_whole(send, tmp_path):
    data = b"t,x\n" * 200_000
    assert await send("run.csv", data) == (200, len(data))
    assert (tmp_path / "logs" / "run.csv").read_bytes() == data
    status, text = await send("run.csv", b"other")
    assert (status, "already" in text) == (409, True)
    assert (tmp_path / "logs" / "run.csv").read_bytes() == data


@pytest.mark.parametrize("name", ["run.exe", ".hidden.csv", "a b.csv", "..csv"])
async def test_names_are_those_of_logs(send, name):
    assert (await send(name, b"x"))[0] == 409


@pytest.mark.parametrize(
    ("name", "data", "why"),
    [
        ("a.csv", b"", "a.csv is empty"),
        ("a.csv", b"\r\n \n", "a.csv is empty"),
        ("a.csv", b"\x7fELF\2\1\1\0\0", "not a text"),
        ("a.csv", b"t_s,x\n", "at least two rows"),
        ("a.csv", b"t_s,x\n0.0,1\n\n", "at least two rows"),
        ("a.mcap", b"t_s,x\n0,1\n1,2\n", "not an MCAP file"),
        ("a.parquet", b"PK\3\4", "not a Parquet file"),
        ("a.db3", b"", "a.db3 is empty"),
    ],
)
async def test_what_is_no_log_is_refused_and_not_kept(send, tmp_path, name, data, why):
    status, text = await send(name, data)
    assert (status, why in text) == (409, True), text
    assert not (tmp_path / "logs" / name).exists()


async def test_logs_of_each_kind_come_in(send):
    for name, data in {
        "a.csv": b"t_s,x\n0.0,1\n0.1,2",
        "b.csv": "t_s;x\n0;1\n1;2\n".encode("utf-16"),
        "a.mcap": b"\x89MCAP0\r\n",
        "a.parquet": b"PAR1" + bytes(8),
        "a.db3": b"SQLite format 3\0",
    }.items():
        assert await send(name, data) == (200, len(data))


async def test_whoever_sends_a_byte_now_and_then_keeps_nobody_out(
    send, tmp_path, monkeypatch
):
    monkeypatch.setattr("hilserver.io.places.YIELDS_AFTER_S", 0.0)
    ends, begun = asyncio.Event(), asyncio.Semaphore(0)

    async def trickle():
        yield b"t\n0\n"
        begun.release()
        await ends.wait()
        yield b"1\n"

    async def slow(number):
        with contextlib.suppress(aiohttp.ClientConnectionError):
            return await send(f"slow{number}.csv", trickle())

    slow_ones = [
        asyncio.create_task(slow(number)) for number in range(module.UPLOADS_AT_ONCE)
    ]
    for _ in slow_ones:
        await begun.acquire()
    await asyncio.sleep(0.1)  # until their requests are at work
    assert await send("run.csv", b"t,x\n0,1\n1,2\n") == (200, 12)
    ends.set()
    answers = await asyncio.gather(*slow_ones)
    assert len(list((tmp_path / "logs").glob("slow*"))) == module.UPLOADS_AT_ONCE - 1
    refused = next(text for status, text in answers if status == 409)
    assert refused.endswith("came too slowly")


async def test_what_is_too_large_is_not_kept(send, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "MAX_BYTES", 1000)
    try:
        status, text = await send("large.csv", b"x" * 1_000_000)
        assert (status, "larger" in text) == (409, True)
    except aiohttp.ClientConnectionError:
        pass  # it was refused while we still sent
    assert not (tmp_path / "logs" / "large.csv").exists()

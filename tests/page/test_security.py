"""What an attacker sends to the page is refused, the server lives, the plant is untouched."""

import asyncio
import contextlib
import io
import json
import random
import re

import aiohttp
import pytest

from tests.page.rig import page_url


class Visitor:
    """What a browser does, by hand: cookie, token, ticket."""

    def __init__(self, session, url):
        self.session, self.url, self.token, self.number = session, url, "", 0
        self.origin = url.rstrip("/")

    async def load(self):
        async with self.session.get(self.url) as response:
            assert response.status == 200
            self.token = re.search(
                r'name="token" content="([^"]+)"', await response.text()
            )[1]
            return response

    async def call(self, method, *arguments, **headers):
        own = {"X-Hilserver-Token": self.token, "Origin": self.origin}
        body = {"method": method, "arguments": list(arguments)}
        url = f"{self.url}api/call"
        async with self.session.post(url, json=body, headers=own | headers) as response:
            text = await response.text()
            return response.status, json.loads(text) if text.startswith("{") else text

    def socket(self, **headers):
        own = {"Origin": self.origin} | headers
        return self.session.ws_connect(
            f"{self.url}api/live", headers=own, max_msg_size=0
        )

    async def live(self):
        """A socket that is let in."""
        socket = await self.socket()
        _, answer = await self.call("ticket")
        await socket.send_json({"ticket": answer["result"]})
        welcome = await socket.receive_json()
        assert welcome["type"] == "welcome"
        self.number = welcome["you"]
        return socket


@pytest.fixture
async def visitor(daemon):
    jar = aiohttp.CookieJar(unsafe=True)
    async with aiohttp.ClientSession(cookie_jar=jar) as session:
        visitor = Visitor(session, page_url(daemon))
        for _ in range(100):
            try:
                await visitor.load()
                break
            except aiohttp.ClientError:
                await asyncio.sleep(0.3)
        yield visitor


async def closed(socket):
    """Wait until the server has closed; return its code."""
    async with asyncio.timeout(120):
        while not socket.closed:
            await socket.receive()
    return socket.close_code


async def test_headers_let_nothing_in_from_elsewhere(visitor):
    response = await visitor.load()
    policy = response.headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert "frame-ancestors 'none'" in policy
    async with visitor.session.get(f"{visitor.url}api/elsewhere") as answer:
        assert answer.status == 404
        assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
    async with visitor.session.get(f"{visitor.url}../../../../etc/passwd") as answer:
        assert answer.status == 404


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1:1"]
)
async def test_another_origin_is_refused(visitor, origin):
    status, _ = await visitor.call("Pause", Origin=origin)
    assert status == 403
    with pytest.raises(aiohttp.WSServerHandshakeError) as refusal:
        await visitor.socket(Origin=origin)
    assert refusal.value.status == 403


@pytest.mark.parametrize(
    ("site", "code"),
    [("cross-site", 403), ("same-site", 403), ("same-origin", 200), ("none", 200)],
)
async def test_a_page_of_others_embeds_nothing_that_is_read(visitor, site, code):
    headers = {"Sec-Fetch-Site": site}  # an image names no origin
    for path in ("api/history", "api/logs"):
        async with visitor.session.get(
            f"{visitor.url}{path}", headers=headers
        ) as response:
            assert response.status == code
    async with visitor.session.get(visitor.url, headers=headers) as response:
        assert response.status == 200, "a link to the page itself is no harm"


async def test_a_foreign_name_for_this_host_is_refused(visitor):
    headers = {"Host": "evil.example"}
    async with visitor.session.get(visitor.url, headers=headers) as response:
        assert response.status == 403


async def test_a_call_needs_cookie_and_token_of_one_browser(visitor):
    assert (await visitor.call("session"))[0] == 200
    assert (await visitor.call("session", **{"X-Hilserver-Token": "x" * 43}))[0] == 403
    async with aiohttp.ClientSession(
        cookie_jar=aiohttp.CookieJar(unsafe=True)
    ) as other:
        stranger = Visitor(other, visitor.url)
        stranger.token = visitor.token
        assert (await stranger.call("session"))[0] == 401
        async with other.get(f"{visitor.url}api/signals") as response:
            # where nobody logs in, programs read without a cookie
            assert response.status == 200
        await stranger.load()
        assert (await stranger.call("session", **{"X-Hilserver-Token": visitor.token}))[
            0
        ] == 403


async def test_a_ticket_opens_one_socket(visitor):
    _, answer = await visitor.call("ticket")
    first = await visitor.socket()
    await first.send_json({"ticket": answer["result"]})
    assert (await first.receive_json())["type"] == "welcome"
    second = await visitor.socket()
    await second.send_json({"ticket": answer["result"]})
    assert await closed(second) == aiohttp.WSCloseCode.POLICY_VIOLATION
    await first.close()


@pytest.mark.parametrize(
    "arguments",
    [
        ("../../etc/passwd",),
        ("/etc/passwd",),
        ("..",),
        ("a/b.csv",),
        ("no-such.csv",),
        (1,),
    ],
)
async def test_names_stay_in_their_folder(visitor, arguments):
    for method in ("diagnose", "StartScenario", "StartRecording", "SaveSnapshot"):
        if method == "SaveSnapshot" and arguments in (("..",), ("no-such.csv",), (1,)):
            continue
        status, answer = await visitor.call(method, *arguments)
        assert status == 409 or (method, arguments) == (
            "StartRecording",
            ("no-such.csv",),
        ), answer
    await visitor.call("StopRecording")


@pytest.mark.parametrize(
    ("method", "arguments"),
    [
        ("write", ["twist.linear_m_s", "fast"]),
        ("write", ["twist.linear_m_s", None]),
        ("write", ["lights.command", 256]),
        ("write", [{}, 1]),
        ("take", ["me"]),
        ("take", [1.5]),
        ("login", [1, None]),
        ("diagnose", [None]),
        ("Force", ["battery.voltage_v", "21"]),
        ("SetSpeed", [True]),
        ("SetSpeed", []),
        ("Step", [-1]),
        ("StartScenario", ["\ud800"]),
        (5, []),
        ("Stop", {"a": 1}),
        ("Stop", "now"),
        ("Stop", 1),
    ],
)
async def test_wrong_types_are_400_with_one_sentence(visitor, method, arguments):
    """Before, most of them were 500 with a traceback in the log."""
    headers = {"X-Hilserver-Token": visitor.token, "Origin": visitor.origin}
    body = {"method": method, "arguments": arguments}
    url = f"{visitor.url}api/call"
    async with visitor.session.post(url, json=body, headers=headers) as response:
        text = await response.text()
        assert response.status == 400, text
        assert "\n" not in text
        assert "Traceback" not in text


async def test_random_frames_end_the_socket_and_nothing_else(visitor, plant):
    rng = random.Random(7)
    for _ in range(40):
        socket = await visitor.live()
        for _ in range(250):  # 10,000 in all
            length = rng.randrange(200)
            if socket.closed:
                break
            if rng.random() < 0.5:
                await socket.send_bytes(rng.randbytes(length))
            else:
                await socket.send_str(rng.randbytes(length).decode("latin-1"))
        assert await closed(socket) == aiohttp.WSCloseCode.POLICY_VIOLATION
    assert plant.command() == 0.0
    assert (await visitor.call("session"))[0] == 200


@pytest.mark.parametrize(
    "message",
    [
        {"drive": {"mode": "twist", "linear": "NaN", "turn": 0, "seen": 0}},
        {"drive": {"mode": "twist", "linear": 0.3, "turn": 0, "seen": 0}},
        {"drive": {"mode": "wheels", "rpm": [50, 50, -50, -50], "seen": 2**31}},
        {"drive": {"mode": "wheels", "rpm": [1], "seen": 1}},
    ],
)
async def test_forged_commands_do_not_move_the_robot(visitor, plant, message):
    socket = await visitor.live()
    await socket.send_json(message)
    async with asyncio.timeout(120):
        while (answer := await socket.receive_json())["type"] != "refused":
            pass
    assert answer["text"]
    assert plant.command() == 0.0
    await socket.close()


async def test_the_driver_drives_on_a_fresh_picture_only(visitor, plant):
    socket = await visitor.live()
    status, answer = await visitor.call("take", visitor.number)
    assert status == 200, answer
    await socket.send_json({"subscribe": ["sim.tick"], "number": 1})
    command = {"mode": "twist", "linear": 0.2, "turn": 0.0}
    # a hand begins at rest
    await socket.send_json({"drive": command | {"linear": 0.0}})
    await socket.send_json({"drive": command | {"seen": await stamp(socket) - 400}})
    async with asyncio.timeout(120):
        while (await socket.receive()).type is not aiohttp.WSMsgType.TEXT:
            pass  # refused: the picture is too old
    assert plant.command() == 0.0
    async with asyncio.timeout(120):
        while plant.command() == 0.0:
            await socket.send_json({"drive": command | {"seen": await stamp(socket)}})
    await socket.close()
    async with asyncio.timeout(120):
        while plant.command() != 0.0:  # noqa: ASYNC110 - the plant tells nobody
            await asyncio.sleep(0.01)
    await visitor.call("give", "opcua")


async def test_a_browser_that_goes_on_holding_over_a_reset_moves_nothing(
    visitor, plant
):
    """Before, a stick that was still held drove at once, with nobody's new command."""
    socket = await visitor.live()
    status, answer = await visitor.call("take", visitor.number)
    assert status == 200, answer
    await socket.send_json({"subscribe": ["sim.tick"], "number": 1})
    command = {"mode": "twist", "linear": 0.2, "turn": 0.0}

    async def held(until):
        async with asyncio.timeout(60):
            while not until():
                await socket.send_json(
                    {"drive": command | {"seen": await stamp(socket)}}
                )

    await socket.send_json({"drive": command | {"linear": 0.0}})
    await held(lambda: plant.command() > 0)
    await visitor.call("Stop")
    await held(lambda: plant.value("sim.state") == 3)
    reset_at = plant.value("sim.tick")
    async with asyncio.timeout(60):
        while not (await visitor.call("Reset"))[1]["ok"]:
            await held(lambda: True)
    await held(
        lambda: (
            plant.value("sim.state") == 1 and plant.value("sim.tick") > reset_at + 1500
        )
    )
    assert plant.command() == 0.0
    assert plant.value("velocity.linear_m_s") == pytest.approx(0.0, abs=1e-3)
    await socket.send_json({"drive": command | {"linear": 0.0}})
    await held(lambda: plant.command() > 0)
    await socket.close()
    await visitor.call("give", "opcua")


async def stamp(socket):
    """The time stamp of the next frame."""
    async with asyncio.timeout(120):
        while (message := await socket.receive()).type is not aiohttp.WSMsgType.BINARY:
            pass
    return int.from_bytes(message.data[4:8], "little")


async def test_ten_megabytes_are_not_taken(visitor):
    socket = await visitor.live()
    with contextlib.suppress(ConnectionError):  # it closes while we still send
        await socket.send_str("x" * 10_000_000)
    await closed(socket)
    url = f"{visitor.url}api/call"
    headers = {"X-Hilserver-Token": visitor.token, "Content-Type": "application/json"}
    with contextlib.suppress(aiohttp.ClientConnectionError):
        async with visitor.session.post(
            url, data=io.BytesIO(b"[" * 10_000_000), headers=headers
        ) as response:
            assert response.status in (400, 413)
    assert (await visitor.call("session"))[0] == 200


async def test_a_thousand_connections_are_not_served_and_the_page_is_there_again(
    visitor,
):
    host, port = visitor.origin.removeprefix("http://").split(":")
    writers = []
    for _ in range(1000):
        try:
            _, writer = await asyncio.wait_for(
                asyncio.open_connection(host, int(port)), 5
            )
        except (OSError, TimeoutError):
            break
        writers.append(writer)
    for writer in writers:
        writer.close()
    for _ in range(50):
        try:
            assert (await visitor.call("session"))[0] == 200
            return
        except aiohttp.ClientError:
            await asyncio.sleep(0.2)
    pytest.fail("the page did not come back")


async def test_more_browsers_than_allowed_are_refused(visitor):
    sockets = [await visitor.live() for _ in range(5)]
    one_more = await visitor.socket()
    assert await closed(one_more) == aiohttp.WSCloseCode.TRY_AGAIN_LATER
    for socket in sockets:
        await socket.close()


async def test_a_client_that_does_not_read_loses_frames_and_slows_nobody(visitor):
    lazy, eager = await visitor.live(), await visitor.live()
    async with visitor.session.get(f"{visitor.url}api/signals") as response:
        names = [signal["name"] for signal in (await response.json())["signals"]]
    for socket in (lazy, eager):
        await socket.send_json({"subscribe": names, "number": 1})
    lazy._reader._protocol.pause_reading()
    frames = 0
    async with asyncio.timeout(120):
        while frames < 60:
            frames += (await eager.receive()).type is aiohttp.WSMsgType.BINARY
    lazy._reader._protocol.resume_reading()
    await lazy.close()
    await eager.close()

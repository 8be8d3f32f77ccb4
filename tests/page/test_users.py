"""Users log in on the page, over TLS; the page logs in for them, encrypted, with their roles."""

import os
import signal
import subprocess

import pytest

from hilserver.commands import main
from hilserver.opcua.passwords import hash_password
from tests.helpers.daemons import running_daemon
from tests.page.conftest import CONFIG
from tests.page.rig import Plant, page_process, page_url
from tests.page.test_security import Visitor, aiohttp, asyncio

PASSWORDS = {"olga": "see", "otto": "drive", "emma": "all"}
FAILED = 3
ROLES = {"olga": "observer", "otto": "operator", "emma": "engineer"}
OPERATOR = {
    "Start", "Stop", "Pause", "Step", "Reset", "SetSpeed", "StartScenario", "StopScenario",
    "StartRecording", "StopRecording",
}  # fmt: skip
CALLS = {
    "LoadPatch": ["no-such.yaml"],
    "RemovePatch": [],
    "SetParameter": ["kinematics.rotation_gain", "tile"],
    "ResetParameters": [],
    "AcceptProposal": [1],
    "RejectProposal": [1],
    "PostponeProposal": [1],
    "SaveParameters": ["../no-such"],
    "StartScenario": ["no-such.yaml"],
    "StopScenario": [],
    "StartRecording": ["no-such.txt"],
    "StopRecording": [],
    "SetSpeed": [1.0],
    "Force": ["battery.voltage_v", 21.0],
    "ClearFaults": [],
    "Pause": [],
    "Start": [],
}
REFUSED = ("your role does not allow", "does not allow")


def make_tls(folder):
    """A certificate of our own for the page, as the how-to makes one."""
    words = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2"]
    words += ["-subj", "/CN=localhost", "-keyout", "page.key", "-out", "page.pem"]
    subprocess.run(words, cwd=folder, check=True, capture_output=True)


@pytest.fixture(scope="module")
def secured(tmp_path_factory):
    folder = tmp_path_factory.mktemp("secured")
    users = [
        f"{{name: {name}, password: '{hash_password(password, log_n=10)}', role: {ROLES[name]}}}"
        for name, password in PASSWORDS.items()
    ]
    opcua = f"policies: [Basic256Sha256], users: [{', '.join(users)}], max_failed_logins: {FAILED}"
    page = (
        "page: {port: 0, max_clients: 5, tls: {certificate: page.pem, key: page.key}}"
    )
    config = CONFIG.replace("page: {port: 0, max_clients: 5}", page)
    make_tls(folder)
    with running_daemon(
        folder, config=config, opcua=opcua, prepare=make_certificate
    ) as daemon:
        yield daemon
        daemon.stop()


def make_certificate(folder):
    assert main(["certs", "make", "-c", str(folder / "config.yaml")]) == 0


async def all_closed():
    """Wait for connections that take leave of their server; aiohttp forgets them at once."""
    open_files = asyncio.get_running_loop()._selector.get_map()
    async with asyncio.timeout(120):
        while len(open_files) > 1:  # the loop's own
            await asyncio.sleep(0.02)
    await asyncio.sleep(0)


@pytest.fixture
async def visit(secured):
    """Log in as a user, each a browser of its own."""
    sessions = []

    async def visit(name=None, password=None):
        connector = aiohttp.TCPConnector(ssl=False)
        jar = aiohttp.CookieJar(unsafe=True)
        sessions.append(aiohttp.ClientSession(cookie_jar=jar, connector=connector))
        visitor = Visitor(sessions[-1], page_url(secured))
        for _ in range(200):
            try:
                await visitor.load()
                break
            except aiohttp.ClientError:
                await asyncio.sleep(0.3)
        if name is not None:
            status, answer = await visitor.call(
                "login", name, password or PASSWORDS[name]
            )
            assert status == 200, answer
            visitor.session_view = answer["result"]
        return visitor

    yield visit
    for session in sessions:
        await session.connector.close(abort_ssl=True)
        await session.close()
    await all_closed()


async def test_nobody_sees_or_does_anything_before_the_log_in(visit):
    visitor = await visit()
    _, answer = await visitor.call("session")
    assert answer["result"]["needs_login"]
    assert answer["result"]["methods"] == []
    for route in ("signals", "hall", "logs", "jobs"):
        async with visitor.session.get(f"{visitor.url}api/{route}") as response:
            assert response.status == 401, route
    for method, arguments in CALLS.items():
        status, answer = await visitor.call(method, *arguments)
        assert (status, answer["text"]) == (409, "log in first"), method
    with pytest.raises(aiohttp.WSServerHandshakeError):
        await visitor.socket()


async def test_a_cookie_from_before_the_log_in_is_worth_nothing_after_it(visit):
    visitor = await visit()
    planted = {c.key: c.value for c in visitor.session.cookie_jar}
    status, _ = await visitor.call("login", "otto", PASSWORDS["otto"])
    assert status == 200
    assert {c.key: c.value for c in visitor.session.cookie_jar} != planted
    assert (await visitor.call("session"))[1]["result"]["user"] == "otto"
    thief = aiohttp.ClientSession(
        cookies=planted,
        cookie_jar=aiohttp.CookieJar(unsafe=True),
        connector=aiohttp.TCPConnector(ssl=False),
    )
    async with thief, thief.get(f"{visitor.url}api/signals") as response:
        assert response.status == 401


async def test_guesses_in_parallel_are_counted_before_they_are_judged(visit):
    visitors = [await visit() for _ in range(2 * FAILED)]
    answers = await asyncio.gather(
        *(v.call("login", "paul", "guess") for v in visitors)
    )
    texts = [answer["text"] for _, answer in answers]
    assert texts.count("name or password is wrong") <= FAILED
    assert sum("too many failed" in text for text in texts) >= FAILED


async def test_a_wrong_password_is_refused_and_the_right_one_is_not_kept_waiting(visit):
    visitor = await visit()
    for name, password in (("otto", "wrong"), ("somebody", "drive"), ("otto", "")):
        status, answer = await visitor.call("login", name, password)
        assert (status, answer["text"]) == (409, "name or password is wrong")
    status, answer = await visitor.call("login", "otto", PASSWORDS["otto"])
    assert status == 200
    assert answer["result"]["user"] == "otto"


async def test_who_fails_too_often_is_told_to_wait_and_nobody_else_is_locked_out(visit):
    visitor = await visit()
    for _ in range(FAILED):
        _, answer = await visitor.call("login", "nobody", "wrong")
        assert answer["text"] == "name or password is wrong"
    _, answer = await visitor.call("login", "nobody", "wrong")
    assert answer["text"].endswith("for this name or address: wait a minute")
    assert (await visitor.call("login", "emma", PASSWORDS["emma"]))[0] == 200


@pytest.mark.parametrize("name", PASSWORDS)
async def test_roles_are_those_of_opcua(visit, secured, name):
    visitor = await visit(name)
    plant = Plant(secured.image)
    may = set(visitor.session_view["methods"])
    assert visitor.session_view["drive"] == (name != "olga")
    assert (may == set()) == (name == "olga")
    if name == "otto":
        assert may == OPERATOR
    for method, arguments in CALLS.items():
        _, answer = await visitor.call(method, *arguments)
        is_refused = any(text in answer.get("text", "") for text in REFUSED)
        assert is_refused == (method not in may), (method, answer)
    await visitor.call("StopRecording")
    for method, arguments in (("diagnose", ["no.csv"]), ("cancel", [1]), ("keep", [1])):
        _, answer = await visitor.call(method, *arguments)
        needed = "LoadPatch" if method == "keep" else "Start"
        is_refused = "your role" in answer["text"]
        assert is_refused == (needed not in may), (method, answer)
    socket = await visitor.live()
    status, answer = await visitor.call("take", visitor.number)
    assert status == (409 if name == "olga" else 200), answer
    _, answer = await visitor.call("write", "lights.command", 3)
    assert answer["ok"] == (name != "olga")
    _, answer = await visitor.call("set", {"plant.max_rpm": 91.0})
    assert answer["ok"] == (name == "emma"), answer
    for wrong in (
        [],
        {},
        {"plant.max_rpm": "1"},
        {"plant.maxrpm": 1.0},
        {"plant.max_rpm": None},
    ):
        assert not (await visitor.call("set", wrong))[1]["ok"], wrong
    await socket.close()
    assert plant.command() == 0.0


async def test_who_has_logged_out_is_out_and_takes_nobody_along(visit):
    emma, otto = await visit("emma"), await visit("otto")
    assert (await emma.call("ClearFaults"))[0] == 200
    await emma.call("logout")
    assert (await emma.call("ClearFaults"))[1]["text"] == "log in first"
    assert (await otto.call("Start"))[0] in (200, 409)
    assert (await otto.call("session"))[1]["result"]["user"] == "otto"


async def test_half_open_handshakes_keep_nobody_out(visit, secured):
    host, port = page_url(secured).removeprefix("https://").rstrip("/").split(":")
    writers = [(await asyncio.open_connection(host, int(port)))[1] for _ in range(300)]
    assert (await visit("otto")).session_view["user"] == "otto"
    for writer in writers:
        writer.transport.abort()


async def test_the_cookie_travels_encrypted_only(visit):
    response = await (await visit()).load()
    cookie = response.cookies or None
    assert response.url.scheme == "https"
    assert cookie is None or all(morsel["secure"] for morsel in cookie.values())


@pytest.mark.page
def test_a_browser_logs_in_and_sees_what_its_role_allows(browser, secured):
    browser.do("visit", url=page_url(secured), selector=".login input")
    browser.do("type", text="olga")
    browser.do("press", key="Tab")
    browser.do("type", text="see")
    browser.do("press", key="Enter")
    browser.do("wait", selector=".state", text="running")
    assert browser.do("run", script="document.querySelector('.wheel').disabled")
    assert browser.do("run", script="document.querySelector('.estop').disabled")
    browser.do("click", role="button", name="Log out olga")
    browser.do("wait", selector=".login input")
    assert browser.do("errors") == []


@pytest.mark.page
def test_a_page_that_was_started_again_asks_to_log_in_again(browser, secured):
    browser.do("visit", url=page_url(secured), selector=".login input")
    browser.do("type", text="otto")
    browser.do("press", key="Tab")
    browser.do("type", text=PASSWORDS["otto"])
    browser.do("press", key="Enter")
    browser.do("wait", selector=".state", text="running")
    os.kill(page_process(secured), signal.SIGKILL)
    browser.do("wait", selector=".banner a", text="Log in again")
    browser.do("click", role="link", name="Log in again")
    browser.do("wait", selector=".login input")

"""The page's server: routes and background tasks; calls are carried out by `calls`."""

import asyncio
import contextlib
import math
import resource
import socket
import ssl
from pathlib import Path

from aiohttp import web

from hilserver.image import ImageReader
from hilserver.io.opcua_server.model import PARAMETERS
from hilserver.io.page import bundle
from hilserver.io.page.browsers import COOKIE, Browser, Browsers
from hilserver.io.page.calls import Calls, WrongTypeError, may_work
from hilserver.io.page.door import MOST, PageDoor
from hilserver.io.page.driving import PageDriving
from hilserver.io.page.files import LOG_SUFFIXES, files_in, reports_in, shown_report
from hilserver.io.page.frames import MAX_PLOTTED, age_ms, history
from hilserver.io.page.gatekeeper import REPORT_POLICY, Gatekeeper
from hilserver.io.page.hand import Hand, RefusedError
from hilserver.io.page.jobs import Jobs
from hilserver.io.page.listening import tls_context
from hilserver.io.page.live import Live
from hilserver.io.page.setup import Setup
from hilserver.io.page.stopping import Stopping
from hilserver.io.page.uploads import Uploads
from hilserver.tasks import Supervisor
from hilserver.time_limit import time_limit

TOKEN_HEADER = "X-Hilserver-Token"  # noqa: S105 - the header's name
SENT_HEADER = "X-Hilserver-Sent"  # by the clock of the frames
# beyond: the clock has wrapped, or the browser is ahead
EXPIRES_MS, FAR_MS = 5_000, 2**31
BODY_BYTES = 65_536
BODY_S = 5.0
SWEEP_S, LOOK_S = 60.0, 1.0


class PageServer:
    """Serves the page of one daemon until it is cancelled.

    FailedError if the daemon does not run, or the page was not built.
    """

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self._assets = bundle.load()
        types = {signal["name"]: signal["type"] for signal in setup.signals}
        types |= {PARAMETERS + row["name"]: "Double" for row in setup.parameters}
        self._browsers = Browsers(
            lambda: Hand(setup.opcua, types),
            anonymous_may_stop=setup.opcua.anonymous_may_stop,
        )
        self._tasks = Supervisor()
        self._door = PageDoor(self._tls(), tasks=self._tasks)
        self._driving = PageDriving(setup.page.deadman_ms)
        self._jobs = Jobs(setup, self._tasks)
        self._uploads = Uploads(setup.folder("recordings"))
        self._image = ImageReader.attach(setup.image)
        stopping = Stopping(setup.image, self._image, self._report_stop, self._tasks)
        self._slots = {signal["name"]: signal["slot"] for signal in setup.signals}
        self._live = Live(
            self._image,
            self._slots,
            self._driving,
            rate_hz=setup.page.rate_hz,
            max_clients=setup.page.max_clients,
            jobs=self._jobs,
            stopping=stopping,
            door=self._door,
            tasks=self._tasks,
        )
        self._calls = Calls(
            setup, self._browsers, self._live, self._driving, self._jobs, stopping
        )

    async def run(self, listener: socket.socket) -> None:
        """Serve on `listener`."""
        _allow_connections()
        runner = web.AppRunner(
            self._application(),
            access_log=None,
            handle_signals=False,
            keepalive_timeout=20.0,
        )
        await runner.setup()
        if runner.server is None:
            return
        self._door.behind = runner.server
        tasks = self._tasks
        tasks.keep("page: door", lambda: self._door.let_in(listener))
        tasks.keep("page: frames", self._live.run)
        tasks.keep("page: commands", self._driving.run)
        tasks.every("page: sweep", SWEEP_S, self._browsers.sweep)
        try:
            while True:
                await asyncio.sleep(LOOK_S)
                tasks.look()
        finally:
            await tasks.end()
            listener.close()
            await self._live.close()
            await self._jobs.close()
            await self._browsers.close()
            await runner.cleanup()

    def _tls(self) -> ssl.SSLContext | None:
        page = self._setup.page
        return (
            tls_context(Path(page.certificate), Path(page.key))
            if page.certificate
            else None
        )

    def _application(self) -> web.Application:
        gatekeeper = Gatekeeper(self._setup.page.host)
        application = web.Application(
            middlewares=[self._door.middleware(), gatekeeper.middleware()],
            client_max_size=BODY_BYTES,
        )
        application.add_routes(
            [
                web.get("/", self._index),
                web.get("/api/signals", self._signals),
                web.get("/api/hall", self._hall),
                web.get("/api/parameters", self._parameters),
                web.get("/api/logs", self._logs),
                web.get("/api/logs/{name}", self._download),
                web.post("/api/logs/{name}", self._upload),
                web.get("/api/history", self._history),
                web.get("/api/jobs", self._list_jobs),
                web.get("/api/reports/sweeps/{folder}/report.html", self._sweep_report),
                web.get("/api/reports/{folder}/{name}", self._report),
                web.post("/api/call", self._call),
                web.get("/api/live", self._socket),
                web.get("/{path:.+}", self._asset),
            ]
        )
        return application

    # --- the page -----------------------------------------------------------------------------

    async def _index(self, request: web.Request) -> web.Response:
        browser = self._browsers.find(request.cookies.get(COOKIE))
        if browser is None:
            browser = await self._browsers.new()
        body = self._assets["index.html"].body.replace(
            bundle.TOKEN, browser.token.encode()
        )
        response = web.Response(body=body, content_type="text/html", charset="utf-8")
        self._show_key(request, response, browser)
        return response

    def _show_key(
        self, request: web.Request, response: web.Response, browser: Browser
    ) -> None:
        if request.cookies.get(COOKIE) != browser.key:
            response.set_cookie(
                COOKIE,
                browser.key,
                httponly=True,
                samesite="Strict",
                secure=bool(self._setup.page.certificate),
                path="/",
            )

    async def _asset(self, request: web.Request) -> web.Response:
        path = request.match_info["path"]
        asset = self._assets.get(path)
        if asset is None or path == "index.html":
            raise web.HTTPNotFound(text="there is no such page")
        headers = {"Content-Type": asset.content_type}
        if path.startswith("assets/"):  # their names change with their content
            headers["Cache-Control"] = "max-age=31536000, immutable"
        if asset.packed is not None and "gzip" in request.headers.get(
            "Accept-Encoding", ""
        ):
            return web.Response(
                body=asset.packed, headers={**headers, "Content-Encoding": "gzip"}
            )
        return web.Response(body=asset.body, headers=headers)

    # --- what it reads ----------------------------------------------------------------------------

    def _known(self, request: web.Request) -> Browser:
        browser = self._browsers.find(request.cookies.get(COOKIE))
        if browser is None:
            raise web.HTTPUnauthorized(text="load the page first")
        browser.address = request.remote or ""
        return browser

    def _reader(self, request: web.Request) -> None:
        if self._setup.opcua.needs_login and not self._known(request).hand.is_connected:
            raise web.HTTPUnauthorized(text="log in first")

    async def _signals(self, request: web.Request) -> web.Response:
        self._reader(request)
        return web.json_response({"signals": self._setup.signals})

    async def _parameters(self, request: web.Request) -> web.Response:
        self._reader(request)
        values = self._image.region("parameters")[0].tolist()
        rows = [
            {**row, "value": value if math.isfinite(value) else None}
            for row, value in zip(self._setup.parameters, values, strict=False)
        ]
        return web.json_response({"parameters": rows})

    async def _hall(self, request: web.Request) -> web.Response:
        self._reader(request)
        return web.json_response(
            {
                "walls": self._setup.walls,
                "robot": self._setup.robot,
                "faults": self._setup.faults,
            }
        )

    async def _logs(self, request: web.Request) -> web.Response:
        self._reader(request)
        folder = self._setup.folder
        sweeps = await asyncio.to_thread(lambda: list(reports_in(folder("sweeps"))))
        return web.json_response(
            {
                "sweeps": sweeps,
                "logs": list(files_in(folder("recordings"), *LOG_SUFFIXES)),
                "scenarios": list(files_in(folder("scenarios"), ".yaml", ".yml")),
                "patches": list(files_in(folder("patches"), ".yaml", ".yml")),
                "snapshots": list(files_in(folder("snapshots"))),
                "folders": {name: folder(name).name for name in self._setup.folders},
                "mappings": self._setup.mappings,
            }
        )

    async def _download(self, request: web.Request) -> web.StreamResponse:
        self._reader(request)
        try:
            return self._uploads.download(request.match_info["name"])
        except RefusedError as error:
            raise web.HTTPNotFound(text=str(error)) from None

    async def _history(self, request: web.Request) -> web.Response:
        self._reader(request)
        names = request.query.getall("name", [])
        unknown = next((name for name in names if name not in self._slots), None)
        if unknown is not None or len(names) > MAX_PLOTTED:
            raise web.HTTPBadRequest(
                text=f"there is no signal '{unknown}', or too many are requested"
            )
        return web.json_response(history(self._image, self._slots, names))

    async def _list_jobs(self, request: web.Request) -> web.Response:
        self._reader(request)
        return web.json_response({"jobs": self._jobs.view()})

    async def _report(self, request: web.Request) -> web.Response:
        self._reader(request)
        path = self._jobs.report(
            request.match_info["folder"], request.match_info["name"]
        )
        return await _shown(path)

    async def _sweep_report(self, request: web.Request) -> web.Response:
        self._reader(request)
        return await _shown(
            shown_report(self._setup.folder("sweeps"), request.match_info["folder"])
        )

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        if request.headers.get("Origin") is None:
            raise web.HTTPForbidden(text="no origin")
        self._reader(request)
        return await self._live.serve(request, self._known(request))

    # --- what it does -----------------------------------------------------------------------------

    def _poster(self, request: web.Request) -> Browser:
        browser = self._known(request)
        if not browser.knows(request.headers.get(TOKEN_HEADER, "")):
            raise web.HTTPForbidden(text="no valid token")
        return browser

    async def _report_stop(self, browser: Browser) -> None:
        await self._calls.report_stop(browser)

    async def _upload(self, request: web.Request) -> web.Response:
        browser = self._poster(request)
        try:
            await self._calls.ready(browser)
            may_work(browser)
            size = await self._uploads.take(request.match_info["name"], request)
        except RefusedError as error:
            return web.json_response({"ok": False, "text": str(error)}, status=409)
        return web.json_response({"ok": True, "result": size})

    async def _call(self, request: web.Request) -> web.Response:
        browser = self._poster(request)
        if request.content_type != "application/json":
            raise web.HTTPUnsupportedMediaType(text="a call is JSON")
        try:
            async with time_limit(BODY_S):
                data = await request.json()
            name, arguments = data["method"], data.get("arguments", [])
        except TimeoutError:
            raise web.HTTPRequestTimeout(
                text="the call did not arrive completely"
            ) from None
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            raise web.HTTPBadRequest(
                text="a call needs a method and arguments"
            ) from None
        if not isinstance(name, str) or not isinstance(arguments, list):
            raise web.HTTPBadRequest(
                text="a call needs a method name and a list of arguments"
            )
        sent = request.headers.get(SENT_HEADER, "")
        if (
            sent.isdecimal()
            and name != "Stop"
            and EXPIRES_MS < age_ms(int(sent)) < FAR_MS
        ):
            text = (
                "it came too late and was not done: the page's server had stood still"
            )
            return web.json_response({"ok": False, "text": text}, status=409)
        try:
            result = await self._calls.do(browser, name, arguments)
        except WrongTypeError as error:
            return web.json_response({"ok": False, "text": str(error)}, status=400)
        except RefusedError as error:
            return web.json_response({"ok": False, "text": str(error)}, status=409)
        response = web.json_response({"ok": True, "result": result})
        self._show_key(request, response, browser)
        return response


async def _shown(path: Path | None) -> web.Response:
    """Return the answer that shows a report, in its own sandbox; 404 if there is none."""
    if path is None:
        raise web.HTTPNotFound(text="there is no such report")
    kind = "text/html" if path.suffix == ".html" else "text/plain"
    headers = {"Content-Security-Policy": REPORT_POLICY}
    body = await asyncio.to_thread(path.read_bytes)
    return web.Response(body=body, content_type=kind, charset="utf-8", headers=headers)


def _allow_connections() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = 4 * MOST
    if soft < wanted:
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (min(wanted, hard), hard))

"""Checks for every request, and headers of every answer."""

from urllib.parse import urlsplit

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

from hilserver.opcua.loopback import is_loopback

_PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:;"
    " connect-src 'self'; font-src 'self'; frame-src 'self'; manifest-src 'self';"
    " base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
REPORT_POLICY = (
    "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:;"
    " base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)
HEADERS = {
    "Content-Security-Policy": _PAGE_POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class Gatekeeper:
    """Refuses requests that were not meant for this page.

    `host`: where the page listens. On loopback only its own names are accepted, so that no foreign
    name can be made to point here (DNS rebinding).
    """

    def __init__(self, host: str) -> None:
        self._is_local = is_loopback(host)

    def is_own(self, request: web.Request) -> bool:
        """Whether the request names this page as its host, and comes from no other origin."""
        host = request.headers.get("Host", "")
        try:
            name = urlsplit(f"//{host}").hostname or ""
            origin = request.headers.get("Origin")
            same = (
                not _is_elsewhere(request)
                if origin is None
                else urlsplit(origin).netloc == host
            )
        except ValueError:
            return False
        return same and (not self._is_local or is_loopback(name))

    def middleware(self) -> Middleware:
        """Return the middleware of the application."""

        @web.middleware
        async def check(request: web.Request, handler: Handler) -> web.StreamResponse:
            try:
                if not self.is_own(request):
                    raise web.HTTPForbidden(text="another origin")
                response = await handler(request)
            except web.HTTPException as error:
                error.headers.update(HEADERS)
                raise
            if not response.prepared:
                for name, value in HEADERS.items():
                    response.headers.setdefault(name, value)
            return response

        return check


def _is_elsewhere(request: web.Request) -> bool:
    """Whether a page of another site, or of another port here, embeds or links the resource.

    Browsers report this even without an origin, for images and scripts; programs do not.
    """
    site = request.headers.get("Sec-Fetch-Site")
    return request.path.startswith("/api/") and site in ("cross-site", "same-site")

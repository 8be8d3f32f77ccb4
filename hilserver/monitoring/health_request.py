"""The head of an HTTP/1.1 request, parsed without I/O: GET and HEAD on a short path, nothing more.

A request that is not clearly well-formed is refused: this server answers scrapers and probes, not
browsers, and every leniency could be abused.
"""

import re
from collections.abc import Collection
from dataclasses import dataclass
from http import HTTPStatus
from ipaddress import ip_address

_REQUEST_LINE = re.compile(rb"([A-Z]{1,16}) (/[\x21-\x7e]*) HTTP/1\.([01])")
_HEADER = re.compile(
    rb"([!#$%&'*+\-.^_`|~0-9A-Za-z]+):[ \t]*([\x20-\x7e\x80-\xff\t]*?)[ \t]*"
)


class RefusedRequestError(Exception):
    """A request that is answered with an error status."""

    def __init__(self, status: HTTPStatus, reason: str) -> None:
        super().__init__(reason)
        self.status = status


@dataclass(frozen=True, slots=True)
class HealthRequest:
    """A well-formed request."""

    path: str  # without the query
    is_head: bool  # the answer has no body
    accept: str  # value of the header ``Accept``, empty without one


def parse_request(
    head: bytes, names: Collection[str] = ("localhost",)
) -> HealthRequest:
    """Parse everything up to and including the empty line; raise `RefusedRequestError`.

    `names`: accepted host names, in lower case; IP addresses are always accepted. Others are not,
    as a web page can reach a server on loopback under its own name (DNS rebinding).
    """
    request_line, *header_lines = head.removesuffix(b"\r\n\r\n").split(b"\r\n")
    match = _REQUEST_LINE.fullmatch(request_line)
    if match is None:
        raise RefusedRequestError(
            HTTPStatus.BAD_REQUEST, "this is not an HTTP/1.1 request line"
        )
    method, target, minor_version = match.groups()
    headers: dict[str, list[str]] = {}
    for number, line in enumerate(header_lines, start=2):
        parts = _HEADER.fullmatch(line)
        if parts is None:
            why = f"line {number} is not a header of the form 'Name: value'"
            raise RefusedRequestError(HTTPStatus.BAD_REQUEST, why)
        name, value = parts.groups()
        headers.setdefault(name.decode("ascii").lower(), []).append(
            value.decode("latin-1")
        )
    if minor_version == b"1" and len(headers.get("host", [])) != 1:
        raise RefusedRequestError(
            HTTPStatus.BAD_REQUEST, "HTTP/1.1 needs exactly one Host header"
        )
    for host in headers.get("host", []):
        if not _is_ours(host, names):
            reason = "this server is not known by that name; see metrics.host_names"
            raise RefusedRequestError(HTTPStatus.MISDIRECTED_REQUEST, reason)
    if method not in {b"GET", b"HEAD"}:
        raise RefusedRequestError(
            HTTPStatus.METHOD_NOT_ALLOWED, "only GET and HEAD are answered"
        )
    path = target.split(b"?", 1)[0].decode("ascii")
    accepted = ", ".join(headers.get("accept", []))
    return HealthRequest(
        path=path,
        is_head=method == b"HEAD",
        accept=accepted,
    )


def _is_ours(host: str, names: Collection[str]) -> bool:
    name = re.sub(r":\d{0,5}$", "", host).lower()
    if name in names:
        return True
    try:
        ip_address(name.removeprefix("[").removesuffix("]"))
    except ValueError:
        return False
    return True

"""The head of an HTTP/1.1 request, parsed without I/O: GET and HEAD on a short path, nothing more.

A request that is not plainly well-formed is refused: this server answers scrapers and probes, not
browsers, and every leniency would be a way to mislead it.
"""

import re
from dataclasses import dataclass
from http import HTTPStatus

_REQUEST_LINE = re.compile(rb"([A-Z]{1,16}) (/[\x21-\x7e]*) HTTP/1\.([01])")
_HEADER = re.compile(rb"([!#$%&'*+\-.^_`|~0-9A-Za-z]+):[ \t]*([\x20-\x7e\x80-\xff\t]*?)[ \t]*")


class RefusedRequestError(Exception):
    """A request that is answered with an error status."""

    def __init__(self, status: HTTPStatus, reason: str) -> None:
        super().__init__(reason)
        self.status = status


@dataclass(frozen=True, slots=True)
class Request:
    """A well-formed request.

    Attributes
    ----------
    path : str
        Without the query.
    is_head : bool
        The answer has no body.
    accept : str
        Value of the header ``Accept``, empty without one.
    """

    path: str
    is_head: bool
    accept: str


def parse_request(head: bytes) -> Request:
    """Parse everything up to and including the empty line; raise `RefusedRequestError`."""
    request_line, *header_lines = head.removesuffix(b"\r\n\r\n").split(b"\r\n")
    match = _REQUEST_LINE.fullmatch(request_line)
    if match is None:
        raise RefusedRequestError(HTTPStatus.BAD_REQUEST, "this is no HTTP/1.1 request line")
    method, target, minor_version = match.groups()
    headers = _parse_headers(header_lines)
    if minor_version == b"1" and len(headers.get("host", [])) != 1:
        raise RefusedRequestError(HTTPStatus.BAD_REQUEST, "HTTP/1.1 needs exactly one Host header")
    if method not in {b"GET", b"HEAD"}:
        raise RefusedRequestError(HTTPStatus.METHOD_NOT_ALLOWED, "only GET and HEAD are answered")
    return Request(
        path=target.split(b"?", 1)[0].decode("ascii"),
        is_head=method == b"HEAD",
        accept=", ".join(headers.get("accept", [])),
    )


def _parse_headers(lines: list[bytes]) -> dict[str, list[str]]:
    headers: dict[str, list[str]] = {}
    for number, line in enumerate(lines, start=2):
        match = _HEADER.fullmatch(line)
        if match is None:
            reason = f"line {number} is no header of the form 'Name: value'"
            raise RefusedRequestError(HTTPStatus.BAD_REQUEST, reason)
        name, value = match.groups()
        headers.setdefault(name.decode("ascii").lower(), []).append(value.decode("latin-1"))
    return headers

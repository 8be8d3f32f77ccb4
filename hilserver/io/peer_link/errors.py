"""Why there is no connection to a peer, or no longer."""

from hilserver.io.peer_link.samples import FaultKind

REFUSED_PAUSE_S = 2.0
LOG_IN_PAUSE_S = 20.0  # servers lock an account after a few failures a minute


class LinkLostError(Exception):
    """The session ended; the message says why in words."""


class RefusedError(Exception):
    """There is no session, and another attempt without a change would not make one."""

    def __init__(self, kind: FaultKind, subject: str, sentence: str) -> None:
        super().__init__(sentence)
        self.kind = kind
        self.subject = subject  # tells reasons of one kind apart
        # shortest time to the next attempt [s]
        self.pause_s = LOG_IN_PAUSE_S if kind is FaultKind.LOG_IN else REFUSED_PAUSE_S


def refusal_in(error: BaseException) -> RefusedError | None:
    """Return the refusal that ended a session or an attempt, None if it was something else."""
    if isinstance(error, BaseExceptionGroup):
        return next(filter(None, map(refusal_in, error.exceptions)), None)
    return error if isinstance(error, RefusedError) else None

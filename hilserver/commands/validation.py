"""The one validation of a configuration that `check` and `run` share, before anything starts."""

from hilserver.commands.options import warn
from hilserver.daemon.assembly import Assembly
from hilserver.daemon.soundness import check_sound
from hilserver.io.page.listening import key_notice, tls_context
from hilserver.opcua.server import own_certificate


def validate(assembly: Assembly) -> None:
    """Refuse what can never work, and files that server, peers, databus or page could not use.

    ConfigError has file, line and key of the configuration, and what to do.
    """
    check_sound(assembly)
    config = assembly.config
    folder = assembly.folder
    if config.opcua.enabled and config.opcua.needs_certificate:
        with assembly.at("opcua"):
            own_certificate(config.opcua, folder)
    for index, peer in enumerate(config.peers):
        from hilserver.io.opcua_client.security import LinkSecurity  # noqa: PLC0415 -- only where used

        with assembly.at("peers", index):
            LinkSecurity(peer, config.opcua, folder)
    if config.edge.enabled:
        from hilserver.io.edge.credentials import credentials  # noqa: PLC0415 -- likewise

        with assembly.at("edge"):
            credentials(config.edge, folder)
    if config.page.enabled:
        check_page(assembly)


def check_page(assembly: Assembly) -> None:
    """Like `validate` for the page alone; warn of a key that others can read."""
    tls = assembly.config.page.tls
    if tls is not None:
        with assembly.at("page", "tls"):
            tls_context(assembly.folder / tls.certificate, assembly.folder / tls.key)
        warn(key_notice(assembly.folder / tls.key))

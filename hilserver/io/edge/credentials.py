"""The files that give access to the databus: a password, certificates and a key."""

import ssl
from pathlib import Path

from hilserver.config.edge import EdgeConfig
from hilserver.errors import ConfigError
from hilserver.small_file import read_small


class _Socket(ssl.SSLSocket):
    """Closes itself when its handshake fails; the client library would leave it open."""

    def do_handshake(self, block: bool = False) -> None:
        try:
            super().do_handshake(block)
        except OSError:
            self.close()
            raise


def credentials(
    config: EdgeConfig, folder: Path
) -> tuple[str | None, ssl.SSLContext | None]:
    """Return password and encryption, None if not configured.

    ConfigError if a file of the section cannot be read or used.
    """
    return _password(config, folder), _context(config, folder)


def _password(config: EdgeConfig, folder: Path) -> str | None:
    path = config.password_file
    if path is None:
        return None
    try:
        lines = read_small(folder / path).decode("utf-8").splitlines()
    except OSError as error:
        raise ConfigError(
            f"password_file: {path} cannot be read: {error.strerror}"
        ) from None
    except UnicodeDecodeError:
        raise ConfigError(
            f"password_file: {path} is not UTF-8; save it as UTF-8"
        ) from None
    if not lines:
        raise ConfigError(
            f"password_file: {path} is empty; put the password on its first line"
        )
    return lines[0]


def _context(config: EdgeConfig, folder: Path) -> ssl.SSLContext | None:
    tls = config.tls
    if tls is None:
        return None
    try:
        context = ssl.create_default_context(cafile=tls.ca and folder / tls.ca)
        context.sslsocket_class = _Socket
        if tls.certificate is not None and tls.key is not None:
            context.load_cert_chain(
                folder / tls.certificate, folder / tls.key, password=""
            )
    except ssl.SSLError as error:
        reason = error.reason or "no PEM"
        raise ConfigError(
            f"tls: a certificate or key cannot be used: {reason}"
        ) from None
    except OSError as error:
        raise ConfigError(f"tls: a file cannot be read: {error.strerror}") from None
    return context

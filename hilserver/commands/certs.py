"""Make and renew our certificate, decide which clients and peers are trusted.

make      a key and a self-signed certificate for this server, and for the links to peers
renew     a new certificate, with the same names and key (--new-key: another key)
list      all certificates, until when they are valid, and how many days that is
trust     trust a client or peer: a file, or one that was rejected (name or thumbprint, its
          beginning)
reject    trust it no longer
revoke    refuse it whatever is trusted, also when an authority issued it
password  ask for a password and print the hash for opcua.users
"""

import argparse
import getpass
import socket
import sys
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path

from cryptography import x509

from hilserver.commands.options import add_config, config_path
from hilserver.config.root import load_config
from hilserver.config.server import OpcUaConfig
from hilserver.errors import EXIT_DONE, EXIT_FAILED, FailedError, UsageError
from hilserver.opcua.certificate import (
    application_uris,
    common_name,
    host_names,
    key_to_pem,
    load_certificate,
    make_certificate,
    make_key,
    thumbprint,
    to_der,
)
from hilserver.opcua.passwords import hash_password
from hilserver.opcua.settings import default_application_uri
from hilserver.opcua.trust_list import (
    FOLDERS,
    TrustList,
    file_name,
    files_in,
    write_private,
)

EXAMPLE = "hilserver certs make --host robot.plant.example --host 192.0.2.7"
_EXAMPLES = {
    "make": "--host robot.plant.example --host 192.0.2.7",
    "renew": "--days 365",
    "list": "--expiring 30",
    "trust": "client.der",
    "reject": "3f2a",
    "revoke": "3f2a",
}
_ANYWHERE = {"0.0.0.0", "::", ""}  # noqa: S104 - recognised, not listened on


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the actions."""
    actions = parser.add_subparsers(
        title="actions", dest="action", metavar="ACTION", required=True
    )
    for name in ("make", "renew"):
        action = _add(actions, name)
        action.add_argument("--host", action="append", default=[], help="name or address of this"
                            " computer that clients use; may be repeated")  # fmt: skip
        action.add_argument(
            "--days", type=int, default=730, help="validity (default: 730)"
        )
        action.add_argument(
            "--new-key", action="store_true", help="also make a new key"
        )
    listing = _add(actions, "list")
    listing.add_argument(
        "--expiring", type=int, metavar="DAYS", default=None,
        help="only those that expire within this many days; exit code 1 if there are any",
    )  # fmt: skip
    for name in ("trust", "reject", "revoke"):
        action = _add(actions, name)
        action.add_argument("certificate", help="file, name or thumbprint")
        _add_folder(action)
    _add_folder(listing)
    _add(actions, "password")


def _add(actions: "argparse._SubParsersAction[argparse.ArgumentParser]", name: str) -> (
    argparse.ArgumentParser
):  # fmt: skip
    words = _EXAMPLES.get(name, "")
    action = actions.add_parser(name, epilog=f"example: hilserver certs {name} {words}")
    add_config(action)
    return action


def _add_folder(action: argparse.ArgumentParser) -> None:
    action.add_argument(
        "--folder",
        type=Path,
        default=None,
        help="folder to use in place of opcua.certificates, such as peers[].security.trust",
    )


def run(args: argparse.Namespace) -> int:
    """Do one action."""
    if args.action == "password":
        if not sys.stdin.isatty():
            password = sys.stdin.readline().rstrip("\n")
        else:
            password = getpass.getpass("password: ")
            if getpass.getpass("again: ") != password:
                raise FailedError("the two passwords differ")
        if not password:
            raise FailedError("the password is empty")
        print(hash_password(password))
        return EXIT_DONE
    path = config_path(args)
    config = load_config(path).opcua
    folder = Path.cwd() if path is None else path.resolve().parent
    key = config.private_key
    trust = TrustList(folder / (getattr(args, "folder", None) or config.certificates))
    trust.make_folders()
    try:
        if args.action in ("make", "renew"):
            return _make(trust, config, None if key is None else folder / key, args)
        if args.action == "list":
            return _list(trust, args.expiring)
        return _move(trust, args.action, args.certificate)
    except OSError as error:
        raise FailedError(f"{error.filename}: {error.strerror}") from None


# --- our own ------------------------------------------------------------------------------------


def _make(
    trust: TrustList,
    config: OpcUaConfig,
    private_key: Path | None,
    args: argparse.Namespace,
) -> int:
    own = trust.folder / "own"
    certificate_path = own / "certificate.der"
    key_path = private_key or own / "key.pem"
    hosts = args.host
    if args.action == "make":
        for path in (certificate_path, key_path):
            if path.exists():
                raise FailedError(f"{path} already exists; use 'hilserver certs renew'")
        key = make_key()
        hosts = hosts or _hosts_of(config)
    else:
        old, key = trust.own(private_key)
        hosts = hosts or host_names(old)
        key = make_key() if args.new_key else key
    if args.days < 1:
        raise UsageError("--days: a certificate must be valid for at least one day")
    uri = config.application_uri or default_application_uri()
    certificate = make_certificate(key, uri, hosts, days=args.days)
    # The key first: a certificate without its key would be refused at the next start.
    if args.action == "make" or args.new_key:
        write_private(key_path, key_to_pem(key))
    write_private(certificate_path, to_der(certificate))
    print(f"{certificate_path}\n{_described(certificate)}")
    return EXIT_DONE


def _hosts_of(config: OpcUaConfig) -> Sequence[str]:
    hosts = [socket.gethostname(), "localhost", "127.0.0.1"]
    if config.host not in (*hosts, *_ANYWHERE):
        hosts.append(config.host)
    return hosts


# --- those of others ------------------------------------------------------------------------------


def _list(trust: TrustList, expiring_days: int | None) -> int:
    rows = [
        f"{folder:8}  {_described(one)}"
        for folder, one in _all(trust)
        if expiring_days is None
        or (folder in FOLDERS[:2] and _days_left(one) <= expiring_days)
    ]
    if rows or expiring_days is None:  # cron mails what a job prints
        print("\n".join(rows) or "no certificates; 'hilserver certs make' makes one")
    return EXIT_FAILED if rows and expiring_days is not None else EXIT_DONE


def _all(trust: TrustList) -> Iterator[tuple[str, x509.Certificate]]:
    for folder in FOLDERS:
        for path in files_in(trust.folder / folder):
            try:
                yield folder, load_certificate(path)
            except ValueError:
                continue  # a key, a revocation list


def _days_left(certificate: x509.Certificate) -> int:
    return (certificate.not_valid_after_utc - datetime.now(UTC)).days


def _described(certificate: x509.Certificate) -> str:
    days = _days_left(certificate)
    left = f"{days} days left" if days >= 0 else "EXPIRED"
    if certificate.not_valid_before_utc > datetime.now(UTC):
        left = f"not valid before {certificate.not_valid_before_utc:%Y-%m-%d}"
    names = [*application_uris(certificate), *host_names(certificate)]
    return (
        f"{thumbprint(certificate)}  until {certificate.not_valid_after_utc:%Y-%m-%d} ({left})"
        f"  {common_name(certificate)}  {' '.join(names)}"
    )


def _move(trust: TrustList, action: str, name: str) -> int:
    certificate, source = _find(trust, name, action)
    target = {"trust": "trusted", "reject": "rejected", "revoke": "revoked"}[action]
    path = trust.folder / target / file_name(certificate)
    write_private(path, to_der(certificate))
    leaves = ("rejected", "revoked") if action == "trust" else ("trusted", "rejected")
    for folder in leaves:
        for other in files_in(trust.folder / folder):
            if other != path and _is_same(other, certificate):
                other.unlink()
    print(f"{source}: now {target}\n{_described(certificate)}")
    return EXIT_DONE


def _is_same(path: Path, certificate: x509.Certificate) -> bool:
    try:
        return load_certificate(path) == certificate
    except ValueError:
        return False


def _find(trust: TrustList, name: str, action: str) -> tuple[x509.Certificate, str]:
    if Path(name).is_file():
        try:
            return load_certificate(Path(name)), name
        except ValueError as error:
            raise FailedError(f"{name} is not a certificate: {error}") from None
    found = {
        thumbprint(certificate): certificate
        for folder, certificate in _all(trust)
        if folder != "own"
        and (
            common_name(certificate) == name
            or thumbprint(certificate).startswith(name.upper().replace(":", ""))
        )
    }
    if not found:
        raise FailedError(
            f"no certificate '{name}' to {action}; 'hilserver certs list' shows all"
        )
    if len(found) > 1:
        raise FailedError(
            f"'{name}' matches {len(found)} certificates; give more of the thumbprint"
        )
    return next(iter(found.values())), name

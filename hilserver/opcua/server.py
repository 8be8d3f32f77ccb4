"""A hardened OPC UA server with the interface of asyncua's.

::

    server = HardenedServer(OpcUaSettings(endpoint="opc.tcp://127.0.0.1:4840/example"))
    await server.init()
    ...                             # nodes, as with asyncua
    async with server:
        ...                         # values
"""

from datetime import UTC, datetime, timedelta
from pathlib import Path

from asyncua import Server, ua
from asyncua.crypto.security_policies import (
    SECURITY_POLICY_TYPE_MAP,
    SecurityPolicyFactory,
    SecurityPolicyNone,
)
from asyncua.server.address_space import AttributeValue
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import rsa

from hilserver.errors import ConfigError, address_refused
from hilserver.opcua import standard_values
from hilserver.opcua.application import Application
from hilserver.opcua.certificate import application_uris
from hilserver.opcua.encoding import FixedDataValue
from hilserver.opcua.internal_server import InnerServer
from hilserver.opcua.logs import log
from hilserver.opcua.settings import OpcUaSettings, Policy, default_application_uri
from hilserver.opcua.spawning import Spawn, spawn_plainly
from hilserver.opcua.transport import Listener
from hilserver.opcua.trust_list import TrustList

_WARN_BEFORE = timedelta(days=30)
_POLICY_TYPES: dict[Policy, ua.SecurityPolicyType] = {
    "None": ua.SecurityPolicyType.NoSecurity,
    "Basic256Sha256": ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
    "Aes128Sha256RsaOaep": ua.SecurityPolicyType.Aes128Sha256RsaOaep_SignAndEncrypt,
    "Aes256Sha256RsaPss": ua.SecurityPolicyType.Aes256Sha256RsaPss_SignAndEncrypt,
}


class HardenedServer(Server):  # type: ignore[misc]
    """asyncua's server with our transport, sessions and subscriptions.

    ConfigError if certificate or key are missing or cannot be used.

    Parameters
    ----------
    settings : OpcUaSettings, optional
        By default without security on loopback.
    folder : Path, optional
        Folder that relative paths of the settings start from; the working directory by default.
    spawn : callable, optional
        Keeps the server's tasks; see `hilserver.opcua.spawning`. By default nobody does.
    """

    def __init__(
        self,
        settings: OpcUaSettings | None = None,
        folder: Path | None = None,
        spawn: Spawn = spawn_plainly,
    ) -> None:
        self.settings = settings = OpcUaSettings() if settings is None else settings
        self._folder = Path.cwd() if folder is None else folder
        trust = None
        if settings.needs_certificate:
            trust = TrustList(self._folder / settings.certificates)
        super().__init__(iserver=InnerServer(settings, trust, spawn))
        self._application_uri = application_uri(settings)
        self.application_type = ua.ApplicationType.Server
        self.set_endpoint(settings.endpoint)
        self.set_security_policy(
            [_POLICY_TYPES[name] for name in settings.offered_policies]
        )
        if trust is not None:
            trust.make_folders()
            certificate, private_key = own_certificate(self.settings, self._folder)
            left = certificate.not_valid_after_utc - datetime.now(UTC)
            if left < _WARN_BEFORE:
                log.warning(
                    "opcua certificate ends",
                    days_left=left.days,
                    remedy="run 'hilserver certs renew'",
                )
            self.iserver.certificate = certificate
            self.iserver.private_key = private_key
            trust.ours = certificate

    @property
    def application(self) -> Application:
        """Answers Write and Call; may be replaced before the first client connects."""
        return self.iserver.application  # type: ignore[no-any-return]

    @application.setter
    def application(self, application: Application) -> None:
        self.iserver.application = application

    @property
    def url(self) -> str:
        """Endpoint with the port that was bound."""
        settings = self.settings
        port = settings.port if self.bserver is None else self.bserver.port
        host = f"[{settings.host}]" if ":" in settings.host else settings.host
        _, _, path = settings.endpoint.removeprefix("opc.tcp://").partition("/")
        return f"opc.tcp://{host}:{port}/{path}"

    async def init(self, shelf_file: Path | None = None) -> None:
        """Fill the standard address space; `shelf_file` is where asyncua would keep it."""
        await super().init(shelf_file)
        standard_values.fill(self.iserver.aspace, self.settings)
        current_time = ua.NodeId(ua.ObjectIds.Server_ServerStatus_CurrentTime)
        attributes = self.iserver.aspace[current_time].attributes
        attributes[ua.AttributeIds.Value] = _LiveTime(None)

    async def start(self) -> None:
        """Listen; FailedError if the address is not available."""
        for policy_type in self._security_policy:
            policy, mode, level = SECURITY_POLICY_TYPE_MAP[policy_type]
            certificate = key = None
            if policy is not SecurityPolicyNone:
                certificate = self.iserver.certificate
                key = self.iserver.private_key
            self._set_endpoints(policy, mode, level)
            self._policies.append(SecurityPolicyFactory(policy, mode, certificate, key))
        host, port = self._get_bind_socket_info()
        self.bserver = Listener(self.iserver, host, port)
        self.bserver.set_policies(self._policies)
        await self.iserver.start()
        try:
            await self.bserver.start()
        except OSError as error:
            await self.iserver.stop()
            where = f"{self.settings.host} port {self.settings.port}"
            raise address_refused(
                f"opcua.endpoint: cannot listen on {where}", error
            ) from None

    def sample(self) -> None:
        """Let subscriptions sample the values written since the last call.

        Otherwise they sample when they publish, and of several changes only the last is seen.
        """
        self.iserver.subscription_service.after_frame()


class _LiveTime(AttributeValue):  # type: ignore[misc]
    """CurrentTime at the moment of the read, not at the last full second.

    Clients estimate the offset of our clock from it.
    """

    @property
    def value(self) -> FixedDataValue:
        """The time now."""
        return FixedDataValue.good(datetime.now(UTC), ua.VariantType.DateTime)

    @value.setter
    def value(self, value: object) -> None:
        """Ignore writes: asyncua's clock only informs the subscribers."""


def own_certificate(
    settings: OpcUaSettings, folder: Path
) -> tuple[x509.Certificate, rsa.RSAPrivateKey]:
    """Return the certificate and key of a server.

    ConfigError if one is missing or cannot be used, or the certificate is that of another
    application.
    """
    trust = TrustList(folder / settings.certificates)
    certificate, key = trust.own(
        None if settings.private_key is None else folder / settings.private_key
    )
    if application_uri(settings) not in application_uris(certificate):
        raise ConfigError(
            f"the certificate in {trust.folder} does not name the application URI"
            f" {application_uri(settings)}: make another with 'hilserver certs renew'"
        )
    return certificate, key


def application_uri(settings: OpcUaSettings) -> str:
    """Return the URI of a server's application, which its certificate must name."""
    return settings.application_uri or default_application_uri()

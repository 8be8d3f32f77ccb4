"""The hand of one browser: a session at the daemon's OPC UA server with its user's rights."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from asyncua import Client, ua
from asyncua.client.ua_client import UaClientState
from asyncua.ua.ua_binary import struct_from_binary

from hilserver.errors import reason
from hilserver.io.opcua_server.method_table import METHOD_OF, METHODS, STRING, Method
from hilserver.io.opcua_server.model import CONTROL_SOURCE, NAMESPACE_URI
from hilserver.io.page.setup import OpcUaAccess
from hilserver.time_limit import time_limit

logging.getLogger("asyncua").setLevel(logging.CRITICAL)

HAND_ANSWER_S = 4.0
LOG_IN_ANSWER_S = 60.0
"""Keys and passwords take their time by design, and a busy computer or a quota multiplies it."""
_TEXTS = 0x80  # additional info of every operation
_VARIANTS = {
    "Double": (ua.VariantType.Double, float),
    "Boolean": (ua.VariantType.Boolean, bool),
    "Byte": (ua.VariantType.Byte, int),
    "UInt32": (ua.VariantType.UInt32, int),
    "Int64": (ua.VariantType.Int64, int),
    STRING: (ua.VariantType.String, str),
}


class RefusedError(Exception):
    """The daemon has refused; the sentence has the reason."""


class WrongPasswordError(RefusedError):
    """The daemon does not know this name with this password."""


@dataclass(frozen=True)
class Rights:
    """What the user of a session may do."""

    drive: bool = False
    methods: tuple[str, ...] = ()


class Hand:
    """Writes and calls for one browser."""

    def __init__(self, access: OpcUaAccess, types: Mapping[str, str]) -> None:
        self._access, self._types = access, {**types, CONTROL_SOURCE: STRING}
        self._client: Client | None = None
        self._index = 0
        self.rights = Rights()

    @property
    def is_connected(self) -> bool:
        """Whether there is a session."""
        client = self._client
        return client is not None and client.uaclient.state is UaClientState.CONNECTED

    async def connect(
        self, name: str = "", password: str = "", address: str = ""
    ) -> None:
        """Open the session, for a user at this address.

        RefusedError if the server does not answer; WrongPasswordError if it does not accept this
        user.
        """
        access = self._access
        if not access.endpoint:
            raise RefusedError(
                "the OPC UA server of the daemon is off: this page is read-only"
            )
        await self.close()
        client = Client(
            access.endpoint, timeout=LOG_IN_ANSWER_S, watchdog_intervall=30.0
        )
        client.name = "hilserver page"
        client.description = f"{access.secret or 'page'} {address} operator"
        try:
            if access.policy:
                await _secure(client, access)
            if name:
                client.set_user(name)
                client.set_password(password)
            async with time_limit(
                None
            ):  # asyncua limits each request, and cancels some itself
                await client.connect()
                self._client = client
                self._index = await client.get_namespace_index(NAMESPACE_URI)
                self.rights = await self._read_rights()
                client.uaclient.protocol.timeout = HAND_ANSWER_S
        except ua.UaStatusCodeError as error:
            await self.close()
            unknown = {
                ua.StatusCodes.BadUserAccessDenied,
                ua.StatusCodes.BadIdentityTokenRejected,
            }
            if error.code in unknown:
                raise WrongPasswordError("name or password is wrong") from None
            raise RefusedError(str(error)) from None
        except (OSError, TimeoutError, ua.UaError) as error:
            await self.close()
            raise RefusedError(
                f"the daemon's OPC UA server does not answer ({_why(error, LOG_IN_ANSWER_S)});"
                " 'hilserver run' starts it"
            ) from None

    async def close(self) -> None:
        """End the session."""
        client, self._client = self._client, None
        self.rights = Rights()
        if client is not None:
            try:
                async with time_limit(HAND_ANSWER_S):
                    await client.disconnect()
            except (OSError, TimeoutError, ua.UaError):
                return

    async def write(self, values: Mapping[str, Any]) -> None:
        """Write signals, all in one tick; RefusedError says why the first one was refused."""
        request = ua.WriteRequest()
        for name, value in values.items():
            item = ua.WriteValue()
            item.NodeId = ua.NodeId(name, self._index)
            item.AttributeId = ua.AttributeIds.Value
            item.Value = ua.DataValue(_variant(self._types[name], value))
            request.Parameters.NodesToWrite.append(item)
        response = await self._ask(request, ua.WriteResponse)
        _check(response.Results, response.DiagnosticInfos)

    async def call(self, name: str, arguments: Sequence[Any]) -> None:
        """Call one method; RefusedError if the daemon refuses, or the arguments do not fit."""
        method = METHOD_OF[name]
        request, item = ua.CallRequest(), ua.CallMethodRequest()
        item.ObjectId = ua.NodeId("methods", self._index)
        item.MethodId = ua.NodeId(method.node_id, self._index)
        item.InputArguments = _arguments(method, arguments)
        request.Parameters.MethodsToCall = [item]
        response = await self._ask(request, ua.CallResponse)
        _check(
            [result.StatusCode for result in response.Results], response.DiagnosticInfos
        )

    async def read(self, names: Sequence[str]) -> list[Any]:
        """Return the values of signals; None for one that has none.

        RefusedError if the daemon does not answer.
        """
        try:
            async with time_limit(None):
                return await self._read(list(names), ua.AttributeIds.Value)
        except (OSError, TimeoutError, ua.UaError) as error:
            raise _silent(error) from None

    async def _ask(self, request: Any, kind: Any) -> Any:
        if self._client is None:
            raise RefusedError("not connected to the daemon")
        request.RequestHeader.ReturnDiagnostics = _TEXTS
        try:
            async with time_limit(None):
                data = await self._client.uaclient.session._send_request(request)
            response = struct_from_binary(kind, data)
            response.ResponseHeader.ServiceResult.check()
        except (OSError, TimeoutError, ua.UaError) as error:
            raise _silent(error) from None
        return response

    async def _read_rights(self) -> Rights:
        executable = await self._read(
            [method.node_id for method in METHODS], ua.AttributeIds.UserExecutable
        )
        (level,) = await self._read(
            ["twist.linear_m_s"], ua.AttributeIds.UserAccessLevel
        )
        methods = tuple(
            m.name for m, may in zip(METHODS, executable, strict=True) if may
        )
        return Rights(bool((level or 0) & ua.AccessLevel.CurrentWrite.mask), methods)

    async def _read(self, names: list[str], attribute: ua.AttributeIds) -> list[Any]:
        if self._client is None:
            return [None] * len(names)
        nodes = [ua.NodeId(name, self._index) for name in names]
        values = await self._client.uaclient.read_attributes(nodes, attribute)
        return [None if value.Value is None else value.Value.Value for value in values]


def _why(error: Exception, limit_s: float) -> str:
    if isinstance(error, TimeoutError):  # an OSError without words
        return f"nothing came for {limit_s:g} s"
    said = reason(error) if isinstance(error, OSError) and error.errno else str(error)
    return said or type(error).__name__


def _silent(error: Exception) -> RefusedError:
    return RefusedError(f"the daemon does not answer: {_why(error, HAND_ANSWER_S)}")


async def _secure(client: Client, access: OpcUaAccess) -> None:
    from asyncua.crypto import security_policies  # noqa: PLC0415 - most pages are in the clear

    policy = getattr(security_policies, f"SecurityPolicy{access.policy}")
    client.application_uri = access.application_uri
    await client.set_security(
        policy, access.certificate, access.key, server_certificate=access.certificate
    )


def _variant(kind: str, value: Any) -> ua.Variant:
    variant_type, convert = _VARIANTS[kind]
    return ua.Variant(convert(value), variant_type)


def _arguments(method: Method, given: Sequence[Any]) -> list[ua.Variant]:
    if len(given) != len(method.arguments):
        raise RefusedError(f"{method.name} takes {len(method.arguments)} arguments")
    try:
        return [
            _variant(a.type, v) for a, v in zip(method.arguments, given, strict=True)
        ]
    except (TypeError, ValueError, OverflowError):
        raise RefusedError(f"{method.name}: an argument has the wrong type") from None


def _check(
    codes: Sequence[ua.StatusCode], infos: Sequence[ua.DiagnosticInfo] | None
) -> None:
    for position, code in enumerate(codes):
        if not code.is_good():
            info = infos[position] if infos and position < len(infos) else None
            raise RefusedError((info.AdditionalInfo if info else None) or code.name)

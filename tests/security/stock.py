"""asyncua's own server, set up as carefully as its interface allows."""

from typing import Any

import asyncua
from asyncua import Server, ua, uamethod

from hilserver.opcua.standard_nodes import QuickInternalServer
from tests.security.pki import Pki


class Stock:
    """A stock server that offers SignAndEncrypt only, with one variable and one method."""

    async def start(self, pki: Pki) -> None:
        assert asyncua.__version__.startswith("2.1."), (
            "the holes are those of this version"
        )
        self.calls = 0
        server = self.server = Server(iserver=QuickInternalServer())
        await server.init()
        server.set_endpoint("opc.tcp://127.0.0.1:0/stock")
        await server.set_application_uri(pki.server.uri)
        await server.load_certificate(str(pki.server.certificate_path))
        await server.load_private_key(str(pki.server.key_path))
        server.set_security_policy(
            [ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt]
        )
        self.index = await server.register_namespace("urn:stock")
        self.speed = ua.NodeId("speed", self.index)
        variable = await server.nodes.objects.add_variable(self.speed, "speed", 0.0)
        await variable.set_writable()

        @uamethod
        def stop(parent: Any) -> None:
            self.calls += 1

        method = await server.nodes.objects.add_method(
            ua.NodeId("stop", self.index), "stop", stop, [], []
        )
        no = ua.DataValue(ua.Variant(False, ua.VariantType.Boolean))
        await method.write_attribute(ua.AttributeIds.Executable, no)
        await method.write_attribute(ua.AttributeIds.UserExecutable, no)
        await server.start()

    @property
    def url(self) -> str:
        return f"opc.tcp://127.0.0.1:{self.server.bserver.port}/stock"

    async def value(self) -> Any:
        return (await self.server.get_node(self.speed).read_data_value()).Value.Value

    async def stop(self) -> None:
        await self.server.stop()

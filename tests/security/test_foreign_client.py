"""node-opcua, a client of another make, with all three policies."""

import asyncio
import json
import shutil
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.serialization import Encoding

from tests.io.opcua_server.rig import Rig
from tests.security.pki import POLICIES, Pki

FOLDER = Path(__file__).parents[1] / "foreign_client"

NAMES = {
    "Basic256Sha256": "Basic256Sha256",
    "Aes128Sha256RsaOaep": "Aes128_Sha256_RsaOaep",
    "Aes256Sha256RsaPss": "Aes256_Sha256_RsaPss",
}

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.node_red]


@pytest.mark.parametrize("policy", POLICIES)
async def test_node_opcua_connects_securely(
    ours: Rig, pki: Pki, tmp_path: Path, policy: str
) -> None:
    node = shutil.which("node")
    assert node, "Node.js 20 is needed (make test installs its packages)"
    assert (FOLDER / "node_modules" / "node-opcua-client").is_dir(), (
        "run: npm install --prefix tests/foreign_client"
    )
    name = NAMES[policy]
    pem = tmp_path / "certificate.pem"
    pem.write_bytes(pki.client.certificate.public_bytes(Encoding.PEM))
    ours.set("pose.x_m", 0.75)
    process = await asyncio.create_subprocess_exec(
        node, "secure.cjs", ours.server.url, name, str(pem), str(pki.client.key_path),
        str(tmp_path / "pki"), "otto", "drive", cwd=FOLDER,
        stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    try:
        out, err = await asyncio.wait_for(process.communicate(), 200)
    finally:
        if process.returncode is None:
            process.kill()
    assert process.returncode == 0, err.decode()
    found = json.loads(out.decode().strip().splitlines()[-1])
    assert found["policy"].endswith(f"#{name}")
    assert (found["pose"], found["wrote"], found["refused"]) == (
        0.75,
        "Good",
        "BadNotWritable",
    )
    assert found["browsed"][0] == found["browsed"][1] == found["pages"] > 2

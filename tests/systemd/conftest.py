"""One container for all tests of this folder; without the tools they fail and say why."""

from collections.abc import Iterator

import pytest

from tests.systemd.container import Container, missing, one_at_a_time, root_file_system
from tests.systemd.service import Service


@pytest.fixture(scope="package")
def container(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Container]:
    if sentence := missing():
        pytest.fail(sentence, pytrace=False)
    with one_at_a_time():
        booted = Container(
            root_file_system(), tmp_path_factory.mktemp("systemd") / "nspawn.log"
        )
        yield booted
        booted.stop()


@pytest.fixture(scope="package")
def installed(container: Container) -> Service:
    service = Service.install(container)
    service.configure("")
    return service


@pytest.fixture
def service(installed: Service) -> Service:
    """Return the service, ready."""
    installed.start()
    return installed

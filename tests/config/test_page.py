"""The page and the network: who opens it from elsewhere is nobody special."""

import pytest
from pydantic import ValidationError

from hilserver.config.root import Config

OPEN = {"host": "0.0.0.0", "tls": {"certificate": "page.pem", "key": "page.key"}}


def test_a_page_on_the_network_on_which_everybody_is_engineer_is_refused():
    with pytest.raises(
        ValidationError, match=r"everyone who opens the page would be engineer"
    ):
        Config(page=OPEN)


@pytest.mark.parametrize(
    "change",
    [
        {"opcua": {"anonymous": "observer"}},
        {"opcua": {"anonymous": "nobody"}},
        {"opcua": {"enabled": False}},
        {"page": {"host": "127.0.0.1"}},
        {"page": {"host": "0.0.0.0", "enabled": False}},
    ],
)
def test_a_page_on_which_strangers_may_nothing_is_not(change):
    Config(**{"page": OPEN, **change})

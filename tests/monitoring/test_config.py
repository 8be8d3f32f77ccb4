"""The sections ``metrics`` and ``logging``: safe by default, strict."""

import pytest
from pydantic import ValidationError

from hilserver.config.monitoring import LoggingConfig, MetricsConfig


def test_defaults_stay_on_loopback() -> None:
    metrics = MetricsConfig()
    assert (metrics.enabled, metrics.host, metrics.port) == (True, "127.0.0.1", 9464)


def test_another_address_must_be_written_down() -> None:
    assert MetricsConfig(host="0.0.0.0").host == "0.0.0.0"
    assert MetricsConfig(host="::1").host == "::1"


@pytest.mark.parametrize(
    ("section", "values"),
    [
        (MetricsConfig, {"host": "localhost.example"}),
        (MetricsConfig, {"host": ""}),
        (MetricsConfig, {"port": 65536}),
        (MetricsConfig, {"prot": 9464}),
        (LoggingConfig, {"level": "LOUD"}),
        (LoggingConfig, {"format": "xml"}),
        (LoggingConfig, {"repeat_window_s": -1}),
        (LoggingConfig, {"repeat_window_s": float("nan")}),
    ],
)
def test_wrong_keys_and_values_are_refused(section: type, values: dict) -> None:
    with pytest.raises(ValidationError):
        section(**values)


def test_every_key_has_a_description() -> None:
    for section in (MetricsConfig, LoggingConfig):
        for key, field in section.model_fields.items():
            assert field.description, key

"""`bench opcua`: a figure only from a server that keeps up."""

import pytest

from benchmarks.opcua import CHANGING, Subject, figures
from benchmarks.opcua_clients import Delivered
from hilserver.errors import FailedError

BLOCK_S = 2.0


def subject(name, n_clients, *, share, cpu_s):
    changed = n_clients * len(CHANGING) * 50.0 * BLOCK_S
    return Subject(
        name,
        "opc.tcp://nowhere",
        1,
        CHANGING,
        cpu_s=[cpu_s] * 3,
        delivered=[Delivered(round(share * changed), 100, 0)] * 3,
        n_clients=n_clients,
    )


def judged(ours_share, stock_share, n_stock=5):
    ours = subject("hilserver", 20, share=ours_share, cpu_s=0.2)
    stock = subject("asyncua", n_stock, share=stock_share, cpu_s=0.5)
    return {result.name: result for result in figures(ours, stock, block_s=BLOCK_S)}


def test_servers_with_as_many_clients_as_they_can_serve_are_compared():
    found = judged(1.0, 0.96)
    share, cost = found["delivered_share"], found["cpu_per_value_us"]
    assert (share.value, share.reference) == pytest.approx((1.0, 0.96))
    assert cost.value == pytest.approx(10.0)
    assert cost.reference == pytest.approx(1e6 * 0.5 / 4800)
    assert cost.ratio == pytest.approx(cost.value / cost.reference)
    assert cost.reference_name == "asyncua, 5 of 20 clients"
    assert cost.raw["asyncua"]["clients"] == 5


def test_a_reference_that_does_not_keep_up_has_no_figure():
    found = judged(1.0, 0.5, n_stock=1)["cpu_per_value_us"]
    assert (found.reference, found.ratio) == (None, None)
    assert found.reference_name == "asyncua delivers 50% to a single client: no figure"


def test_a_server_of_ours_that_does_not_keep_up_is_a_sentence():
    with pytest.raises(
        FailedError, match=r"21% of the values were delivered to 20 clients: .*95%"
    ):
        judged(0.21, 1.0)


def test_each_reference_has_its_rows():
    ours = subject("hilserver", 20, share=1.0, cpu_s=0.2)
    stock = subject("asyncua", 5, share=1.0, cpu_s=0.5)
    compiled = subject("open62541", 20, share=1.0, cpu_s=0.1)
    found = {r.name: r for r in figures(ours, stock, compiled, block_s=BLOCK_S)}
    assert found["cpu_per_value_us"].ratio == pytest.approx(0.1)
    beside = found["cpu_per_value_us_open62541"]
    assert (beside.value, beside.ratio) == pytest.approx((10.0, 2.0))

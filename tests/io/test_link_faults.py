"""The book of faults: told once, kept while it lasts."""

from hilserver.core.events import Event
from hilserver.io.link_status import FAULTS_MAX, HOLD_NS, FaultBook, PeerStatus
from hilserver.io.peer_link.samples import FaultKind

LOG_IN, CERTIFICATE = FaultKind.LOG_IN, FaultKind.CERTIFICATE


def make_book() -> tuple[FaultBook, PeerStatus, list[Event]]:
    status, told = PeerStatus("plc"), []
    return FaultBook(status, told.append), status, told


def test_a_refusal_lasts_until_it_is_over_and_is_told_once() -> None:
    book, status, told = make_book()
    for attempt in range(5):
        now_ns = attempt * 10 * HOLD_NS
        book.refuse(CERTIFICATE, "expired", "it is expired", now_ns)
        book.expire(now_ns + 2 * HOLD_NS)
        assert status.faults == {"certificate:expired": "it is expired"}
    assert [event.message for event in told] == ["peer plc: it is expired"]
    assert status.fault_counts[CERTIFICATE] == 5
    book.admit()
    assert status.faults == {}
    book.admit()


def test_another_reason_takes_its_place() -> None:
    book, status, told = make_book()
    book.refuse(CERTIFICATE, "expired", "it is expired", 0)
    book.refuse(LOG_IN, "user", "wrong user", 1)
    assert list(status.faults.values()) == ["wrong user"]
    book.refuse(CERTIFICATE, "expired", "it is expired", 2)
    assert list(status.faults.values()) == ["it is expired"]
    assert len(told) == 3


def test_other_faults_end_by_themselves_beside_a_refusal() -> None:
    book, status, _ = make_book()
    book.refuse(LOG_IN, "user", "wrong user", 0)
    book.report(FaultKind.NOT_FINITE, "node", "nan", 0)
    book.expire(2 * HOLD_NS)
    assert list(status.faults.values()) == ["wrong user"]


def test_a_full_book_takes_no_refusal_and_loses_none() -> None:
    book, status, _ = make_book()
    for node in range(FAULTS_MAX):
        book.report(FaultKind.NOT_FINITE, str(node), "nan", 0)
    book.refuse(LOG_IN, "user", "wrong user", 0)
    book.admit()
    assert len(status.faults) == FAULTS_MAX

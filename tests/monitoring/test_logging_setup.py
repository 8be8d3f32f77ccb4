"""Log lines: readable or JSON, no traceback for what was to be expected, repetitions counted."""

import io
import json
import logging
import time
from collections.abc import Iterator

import pytest
import structlog
from hypothesis import given
from hypothesis import strategies as st

from hilserver.core.events import Event, EventKind
from hilserver.errors import FailedError
from hilserver.monitoring.logging_setup import (
    ALLOWED_AT_ONCE,
    KEYS_MAX,
    RepeatLimiter,
    log_event,
    log_overrun,
    notice,
    report_repeats,
    setup_logging,
)
from hilserver.scheduler.causes import OverrunCause
from hilserver.scheduler.overruns import OverrunReport


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture(autouse=True)
def logging_as_before() -> Iterator[None]:
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    # silenced by whoever ran a server before
    library = logging.getLogger("asyncua.server")
    library_level = library.level
    library.setLevel(logging.NOTSET)
    yield
    library.setLevel(library_level)
    structlog.reset_defaults()
    root.handlers[:], root.level = handlers, level


def json_lines(stream: io.StringIO) -> list[dict]:
    return [json.loads(line) for line in stream.getvalue().splitlines()]


def test_json_where_there_is_no_terminal() -> None:
    stream = io.StringIO()
    setup_logging(stream=stream)
    structlog.get_logger("hilserver.test").warning(
        "too hot", wheel="fl", speed_rpm=91.5
    )
    (line,) = json_lines(stream)
    assert line.pop("timestamp").endswith("Z")
    assert line == {
        "event": "too hot",
        "level": "warning",
        "logger": "hilserver.test",
        "wheel": "fl",
        "speed_rpm": 91.5,
    }


def test_readable_on_a_terminal_unless_json_is_asked_for() -> None:
    stream = Terminal()
    setup_logging(stream=stream)
    structlog.get_logger().info("hello", wheel="fl")
    assert "hello" in stream.getvalue()
    assert not stream.getvalue().startswith("{")

    stream = Terminal()
    setup_logging(stream=stream, line_format="json")
    structlog.get_logger().info("hello")
    assert json_lines(stream)[0]["event"] == "hello"


def test_a_terminal_shows_local_time_and_no_logger_name(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("TZ", "XYZ-5")  # five hours ahead of UTC
    time.tzset()
    stream = Terminal()
    setup_logging(stream=stream)
    hour = time.gmtime(time.time() + 5 * 3600).tm_hour
    structlog.get_logger("hilserver.test").info("hello")
    monkeypatch.undo()
    time.tzset()
    assert f"{hour:02}:" in stream.getvalue()
    assert "hilserver.test" not in stream.getvalue()


def test_a_notice_passes_whatever_the_level() -> None:
    stream = io.StringIO()
    setup_logging("ERROR", stream=stream)
    structlog.get_logger().warning("left out")
    notice("reload: changed", key="logging.level")
    (line,) = json_lines(stream)
    assert (line["event"], line["key"]) == ("reload: changed", "logging.level")


def test_level_counts_for_us_and_for_libraries() -> None:
    stream = io.StringIO()
    setup_logging("WARNING", stream=stream)
    structlog.get_logger().info("left out")
    logging.getLogger("some.library").info("left out")
    logging.getLogger("some.library").warning("told, %d times", 3)
    (line,) = json_lines(stream)
    assert (line["event"], line["logger"]) == ("told, 3 times", "some.library")


def test_libraries_tell_their_information_only_to_nobody() -> None:
    stream = io.StringIO()
    setup_logging("DEBUG", stream=stream)
    logging.getLogger("asyncua.server").info("left out")
    logging.getLogger("asyncio").debug("left out")
    logging.getLogger("asyncua.server").warning("told")
    assert [line["event"] for line in json_lines(stream)] == ["told"]


def test_a_traceback_of_the_opcua_library_is_one_line() -> None:
    stream = io.StringIO()
    setup_logging("INFO", "json", stream=stream)
    try:
        raise RuntimeError("a client went\naway")
    except RuntimeError:
        logging.getLogger("asyncua.server.uaprocessor").exception("answering failed")
    (line,) = stream.getvalue().splitlines()
    told = json.loads(line)
    assert told["event"] == "answering failed"
    assert told["error"].startswith("RuntimeError: a client went")
    assert "exception" not in told


@pytest.mark.parametrize(
    "error", [ConnectionRefusedError("no peer"), FailedError("port in use")]
)
@pytest.mark.parametrize("line_format", ["json", "console"])
def test_an_expected_error_is_one_line(error: Exception, line_format: str) -> None:
    stream = io.StringIO()
    setup_logging(stream=stream, line_format=line_format)
    try:
        raise error
    except type(error):
        logging.getLogger("asyncua").exception("cannot connect")
        structlog.get_logger("ours").exception("cannot connect")
    assert len(stream.getvalue().splitlines()) == 2
    assert stream.getvalue().count(str(error)) == 2
    assert "Traceback" not in stream.getvalue()


@pytest.mark.parametrize("line_format", ["json", "console"])
def test_a_defect_keeps_its_traceback(line_format: str) -> None:
    stream = io.StringIO()
    setup_logging(stream=stream, line_format=line_format)
    try:
        _ = 1 / 0
    except ZeroDivisionError:
        logging.getLogger("library").exception("broken")
    assert "Traceback" in stream.getvalue()
    assert "ZeroDivisionError" in stream.getvalue()


def test_a_library_s_wrong_format_arguments_do_not_raise() -> None:
    stream = io.StringIO()
    setup_logging(stream=stream)
    wrong = "%d and %d"
    logging.getLogger("library").warning(wrong, 1)
    logging.getLogger("library").log(35, "between two levels, 100 %")
    events = [line["event"] for line in json_lines(stream)]
    assert events == [wrong, "between two levels, 100 %"]


def test_foreign_text_can_neither_forge_lines_nor_steer_the_terminal() -> None:
    stream = Terminal()
    setup_logging(stream=stream, line_format="console")
    evil = "x\n2031-01-01 [info] all is well\x1b[2J\u202e"
    logging.getLogger("asyncua").warning("session %s", evil)
    structlog.get_logger().warning("name", peer=evil)
    text = stream.getvalue()
    assert len(text.splitlines()) == 2
    assert "\x1b[2J" not in text
    assert "\u202e" not in text


def test_long_text_is_bounded() -> None:
    stream = io.StringIO()
    setup_logging(stream=stream)
    structlog.get_logger().warning("x" * 10**6)
    assert len(stream.getvalue()) < 3000
    assert "998000 characters more" in stream.getvalue()


def test_a_stream_that_is_gone_stops_nobody() -> None:
    stream = io.StringIO()
    setup_logging(stream=stream)
    stream.close()
    structlog.get_logger().error("nobody hears this")


def test_a_terminal_without_unicode_gets_escapes() -> None:
    raw = io.BytesIO()
    setup_logging(stream=io.TextIOWrapper(raw, encoding="ascii"), line_format="console")
    structlog.get_logger().warning("36 µs")
    assert rb"36 \xb5s" in raw.getvalue()


def passed(limiter: RepeatLimiter, event: str, **fields: object) -> dict | None:
    try:
        return dict(limiter(None, "info", {"event": event, **fields}))
    except structlog.DropEvent:
        return None


def test_repetitions_are_left_out_and_counted() -> None:
    clock = Clock()
    limiter = RepeatLimiter(10.0, clock)
    assert passed(limiter, "overrun", slice="plant") == {
        "event": "overrun",
        "slice": "plant",
    }
    for _ in range(3):
        assert passed(limiter, "overrun", slice="plant") is None
    clock.now_s = 10.0
    assert passed(limiter, "overrun", slice="plant")["suppressed"] == 3
    clock.now_s = 20.0
    assert "suppressed" not in passed(limiter, "overrun", slice="plant")


def test_another_slice_or_cause_is_another_line_and_another_number_is_not() -> None:
    limiter = RepeatLimiter(10.0, Clock())
    assert passed(limiter, "late by 3.5 us", slice="plant", cause="preempted", tick=1)
    assert (
        passed(limiter, "late by 9 us", slice="plant", cause="preempted", tick=2)
        is None
    )
    assert passed(limiter, "late by 9 us", slice="plant", cause="page fault")
    assert passed(limiter, "late by 9 us", slice="publish", cause="preempted")
    assert passed(limiter, "degraded", item="governor")
    assert passed(limiter, "degraded", item="swap")


def test_a_defect_that_repeats_tells_its_traceback_once() -> None:
    stream = io.StringIO()
    setup_logging(stream=stream)
    for _ in range(3):
        try:
            _ = 1 / 0
        except ZeroDivisionError:
            logging.getLogger("library").exception(
                "broken in <Task at %#x>", id(object())
            )
    assert len(json_lines(stream)) == 1


def test_changes_of_state_are_shown_more_often() -> None:
    limiter = RepeatLimiter(10.0, Clock())
    lines = [
        passed(limiter, "paused", kind="state") for _ in range(ALLOWED_AT_ONCE + 2)
    ]
    assert [line is not None for line in lines] == [True] * ALLOWED_AT_ONCE + [
        False
    ] * 2


def test_window_0_lets_everything_pass() -> None:
    limiter = RepeatLimiter(0.0, Clock())
    assert all(passed(limiter, "again") for _ in range(5))


def test_memory_is_bounded_and_the_busy_line_stays_known() -> None:
    limiter = RepeatLimiter(10.0, Clock())
    passed(limiter, "flood")
    for number in range(5 * KEYS_MAX):
        assert passed(limiter, "other", peer="ab"[number % 2] * number)
        assert passed(limiter, "flood") is None
    assert len(limiter._seen) == KEYS_MAX


@given(st.lists(st.tuples(st.sampled_from("abc"), st.floats(0, 7)), max_size=60))
def test_every_line_is_told_or_counted(run: list[tuple[str, float]]) -> None:
    clock = Clock()
    limiter = RepeatLimiter(10.0, clock)
    told = counted = 0
    last_told_s: dict[str, float] = {}
    for event, wait_s in run:
        clock.now_s += wait_s
        line = passed(limiter, event)
        if line is not None:
            assert clock.now_s - last_told_s.get(event, -10.0) >= 10.0
            last_told_s[event] = clock.now_s
            told += 1
            counted += line.get("suppressed", 0)
        else:
            assert clock.now_s - last_told_s[event] < 10.0
    counted += sum(n for _, n in limiter.take_finished(all_windows=True))
    assert told + counted == len(run)
    assert limiter.suppressed == counted
    assert limiter.take_finished(all_windows=True) == []


def test_the_end_of_a_burst_is_reported() -> None:
    stream, clock = io.StringIO(), Clock()
    limiter = setup_logging(stream=stream, clock_s=clock)
    for _ in range(5):
        structlog.get_logger().warning("peer sends nonsense 7")
    report_repeats(limiter)
    assert len(json_lines(stream)) == 1
    clock.now_s = 10.0
    report_repeats(limiter)
    report_repeats(limiter)
    last = json_lines(stream)[1:]
    assert [(line["reason"], line["suppressed"]) for line in last] == [
        ("peer sends nonsense #", 4)
    ]


def overrun(consequence: str = "", tick: int = 4711) -> OverrunReport:
    cause = OverrunCause.PREEMPTED
    return OverrunReport(
        "plant", "late_wake", tick, 1_234_567, 2_000, 1, cause, consequence
    )


def test_an_overrun_line_names_slice_kind_and_cause() -> None:
    stream = io.StringIO()
    setup_logging(stream=stream)
    log_overrun(overrun())
    (line,) = json_lines(stream)
    assert (line["slice"], line["kind"], line["cause"]) == (
        "plant",
        "late_wake",
        "preempted",
    )
    assert (line["tick"], line["level"]) == (4711, "warning")
    assert "1.235 ms late" in line["event"]


def test_repeated_overruns_are_one_line_until_something_follows() -> None:
    stream = io.StringIO()
    setup_logging(stream=stream)
    for tick in range(100):
        log_overrun(overrun(tick=tick))
    log_overrun(overrun("single_overrun_limit"))
    assert [line["level"] for line in json_lines(stream)] == ["warning", "error"]


@pytest.mark.parametrize(
    ("severity", "level"), [(100, "info"), (300, "warning"), (900, "error")]
)
def test_events_are_logged_by_severity(severity: int, level: str) -> None:
    stream = io.StringIO()
    setup_logging(stream=stream)
    log_event(Event(EventKind.PEER_LOST, severity, "iot2050", "no answer for 500 ms"))
    (line,) = json_lines(stream)
    assert (line["level"], line["kind"], line["source"]) == (
        level,
        "peer_lost",
        "iot2050",
    )


def test_an_overrun_event_is_not_told_twice() -> None:
    stream = io.StringIO()
    setup_logging(stream=stream)
    log_event(Event(EventKind.OVERRUN, 500, "plant", "late"))
    assert stream.getvalue() == ""


def test_toggling_states_are_all_told() -> None:
    stream = io.StringIO()
    setup_logging(stream=stream)
    for _ in range(3):
        for state in ("paused", "running"):
            log_event(
                Event(EventKind.STATE, 100, "control", f"the state is now {state}")
            )
    assert len(json_lines(stream)) == 6

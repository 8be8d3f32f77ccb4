"""Logs to and from the browser, sweeps, what the ring remembers, a log of others that is mapped."""

import pytest

from tests.page.rig import diagnoses, lift
from tests.page.test_security import visitor  # noqa: F401 - a fixture

FOREIGN = "stamp,left_rpm,right_rpm\n" + "".join(
    f"{i * 0.02},50,-50\n" for i in range(200)
)


async def upload(visitor, name, data, **headers):  # noqa: F811
    own = {"X-Hilserver-Token": visitor.token, "Origin": visitor.origin} | headers
    async with visitor.session.post(
        f"{visitor.url}api/logs/{name}", data=data, headers=own
    ) as response:
        return response.status, await response.text()


async def test_a_log_goes_up_and_comes_down_again(visitor, daemon):  # noqa: F811
    data = b"\x89MCAP0\r\n" + bytes(range(256)) * 1000
    assert (await upload(visitor, "sent.mcap", data))[0] == 200
    assert (daemon.folder / "recordings" / "sent.mcap").read_bytes() == data
    async with visitor.session.get(f"{visitor.url}api/logs/sent.mcap") as response:
        assert await response.read() == data
        assert "attachment" in response.headers["Content-Disposition"]
        assert "default-src 'none'" in response.headers["Content-Security-Policy"]
    assert (await upload(visitor, "sent.mcap", b"other"))[0] == 409
    assert (await upload(visitor, "..%2f..%2fx.csv", b"x"))[0] in (404, 409)
    assert (await upload(visitor, "x.csv", b"x", **{"X-Hilserver-Token": "x"}))[
        0
    ] == 403
    async with visitor.session.get(f"{visitor.url}api/logs/absent.csv") as response:
        assert response.status == 404


async def test_a_plot_begins_with_what_the_ring_holds(visitor):  # noqa: F811
    url = f"{visitor.url}api/history?name=sim.tick&name=battery.voltage_v"
    async with visitor.session.get(url) as response:
        answer = await response.json()
    times, ticks = answer["times"], answer["series"]["sim.tick"]
    assert 10 < len(times) <= 700
    assert times == sorted(set(times))
    assert ticks == sorted(ticks)
    assert len(answer["series"]["battery.voltage_v"]) == len(times)
    for query in ("name=no.such", "&".join(["name=sim.tick"] * 30)):
        async with visitor.session.get(f"{visitor.url}api/history?{query}") as response:
            assert response.status == 400


def sweep(daemon, name, title):
    folder = daemon.folder / "sweeps" / name
    folder.mkdir(parents=True)
    (folder / "report.html").write_text(
        f"<title>{title}</title><h1>{title}</h1>", encoding="utf-8"
    )
    (folder / "summary.json").write_text("{}", encoding="utf-8")


async def test_sweeps_are_listed_and_only_their_reports_can_be_read(visitor, daemon):  # noqa: F811
    sweep(daemon, "friction", "144 of 300 machines pass")
    async with visitor.session.get(f"{visitor.url}api/logs") as response:
        rows = (await response.json())["sweeps"]
    assert ("friction", "144 of 300 machines pass") in [
        (row["name"], row["title"]) for row in rows
    ]
    url = f"{visitor.url}api/reports/sweeps"
    async with visitor.session.get(f"{url}/friction/report.html") as response:
        assert "144 of 300" in await response.text()
        assert response.headers["Content-Security-Policy"].startswith("sandbox;")
    for wrong in (
        "friction/summary.json",
        "absent/report.html",
        "..%2fsweeps%2ffriction/report.html",
    ):
        async with visitor.session.get(f"{url}/{wrong}") as response:
            assert response.status == 404, wrong


@pytest.mark.page
def test_the_report_of_a_sweep_opens_on_the_page(browser, url, daemon):
    sweep(daemon, "scatter", "9 of 10 machines pass")
    browser.do("open", url=url)
    browser.do("view", name="Diagnosis")
    browser.do(
        "wait", selector="[aria-label='Sweeps'] li", text="9 of 10 machines pass"
    )
    browser.do("click", role="button", name="Read the report of scatter")
    assert browser.do("framed", selector="h1") == "9 of 10 machines pass"
    assert browser.do("errors") == []


@pytest.mark.page
def test_a_log_of_others_is_mapped_on_the_page(browser, url, plant, daemon):
    """Its columns are no signals: the guess of the diagnosis is shown, completed and kept."""
    folder = daemon.folder / "recordings"
    folder.mkdir(exist_ok=True)
    (folder / "foreign.csv").write_text(FOREIGN, encoding="utf-8")
    browser.do("open", url=url)
    browser.do("view", name="Diagnosis")
    browser.do("click", role="button", name="Diagnose foreign.csv")
    plant.wait(lambda: diagnoses(daemon))
    for pid in diagnoses(daemon):
        lift(pid)
    browser.do("click", role="button", name="Name the columns")
    text = browser.do("run", script="document.querySelector('dialog textarea').value")
    assert "left_rpm" in text
    browser.do("click", role="button", name="Diagnose with it")
    plant.wait((folder / "foreign.csv.mapping.yaml").exists)
    assert (folder / "foreign.csv.mapping.yaml").read_text(encoding="utf-8") == text
    browser.do("wait", selector=".jobs li", text="foreign.csv")
    browser.do("click", role="button", name="Cancel")
    assert browser.do("errors") == []

"""Every view by keyboard alone, and without serious faults of accessibility, light and dark."""

import re

import pytest

from hilserver.diagnosis.report import render
from hilserver.faults.model import FORMS
from tests.diagnosis.sample import evidence, findings

pytestmark = pytest.mark.page
VIEWS = ("Drive", "Watch", "Signals", "Time", "Diagnosis", "Tune")
_CONTROLS = """
window.controls = new Set([...document.querySelectorAll(
    "a[href], button, input, select, textarea, [tabindex='0']")].filter((e) =>
    !e.disabled && e.checkVisibility({ visibilityProperty: true }) && e.tabIndex >= 0));
window.marked = new Set(); window.unseen = new Set();
document.addEventListener("focusin", (event) => {
  window.marked.add(event.target);
  const style = getComputedStyle(event.target);
  if (style.outlineStyle === "none" || parseFloat(style.outlineWidth) < 2)
    window.unseen.add(event.target.outerHTML.slice(0, 80));
});
document.body.tabIndex = -1; document.body.focus(); window.controls.size
"""
_MISSED = """[...window.controls].filter((e) => e.checkVisibility() && !window.marked.has(e))
    .map((e) => e.outerHTML.slice(0, 80))"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_no_view_has_a_fault_of_accessibility(browser, url, scheme):
    browser.do("fresh", scheme=scheme)
    browser.do("open", url=url)
    for name in VIEWS:
        browser.do("view", name=name)
        assert browser.do("axe") == [], name
    assert browser.do("errors") == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_no_report_has_a_fault_of_accessibility(browser, tmp_path, scheme):
    """What stands in the frame of the view Diagnosis, with everything unfolded."""
    report = tmp_path / "report.html"
    report.write_text(render(findings(), evidence()), encoding="utf-8")
    browser.do("fresh", width=700, scheme=scheme)
    browser.do("visit", url=report.as_uri(), selector="main")
    browser.do(
        "run",
        script="document.querySelectorAll('details').forEach((d) => d.open = true)",
    )
    assert browser.do("axe") == []


@pytest.mark.parametrize(("key", "view"), list(zip("123456", VIEWS, strict=True)))
def test_every_control_is_reached_and_seen_by_the_tab_key(browser, url, key, view):
    browser.do("open", url=url)
    browser.do("take")
    browser.do("press", key=key)
    # the table of parameters
    came_later = " input[type='range']" if view == "Tune" else ""
    browser.do("wait", selector=f"main[data-view='{view.lower()}']{came_later}")
    count = browser.do("run", script=_CONTROLS)
    assert count >= 8
    browser.do("press", key="Tab", times=count + 4)
    assert browser.do("run", script=_MISSED) == []
    assert browser.do("run", script="[...window.unseen]") == []


def test_a_whole_shift_by_keyboard(browser, url, plant):
    """Take control, drive, pause, step, force and release, stop, reset: no pointer."""
    browser.do("open", url=url)
    browser.do("to", name="Take control")
    browser.do("press", key="Enter")
    browser.do("wait", selector=".owner", text="You drive")
    browser.do("down", key="ArrowUp")
    plant.wait(lambda: plant.command() > 0.1)
    browser.do("up", key="ArrowUp")
    plant.wait(lambda: plant.command() == 0.0)
    browser.do("press", key="4")
    browser.do("to", name="Pause")
    browser.do("press", key="Enter")
    browser.do("wait", selector=".state", text="paused")
    tick = plant.value("sim.tick")
    browser.do("to", name="Step")
    browser.do("press", key="Enter")
    plant.wait(lambda: plant.value("sim.tick") == tick + 100)
    browser.do("to", name="Resume")
    browser.do("press", key="Enter")
    browser.do("wait", selector=".state", text="running")
    browser.do("press", key="3")
    browser.do("to", name="Find a signal")
    browser.do("type", text="battery.v")
    browser.do("to", name="Force battery.voltage_v")
    browser.do("press", key="Enter")
    browser.do("type", text="21.5")
    browser.do("press", key="Enter")
    plant.wait(lambda: plant.value("battery.voltage_v") == 21.5)
    browser.do("wait", selector=".list", text="battery.voltage_v")
    browser.do("to", name="Release battery.voltage_v")
    browser.do("press", key="Enter")
    plant.wait(lambda: plant.value("battery.voltage_v") != 21.5)
    browser.do("run", script="document.activeElement.blur()")
    browser.do("press", key="x")
    plant.wait(lambda: plant.value("sim.state") == 3)
    browser.do("wait", selector=".state", text="safe")
    browser.do("to", name="Reset")
    browser.do("press", key="Enter")
    plant.wait(lambda: plant.value("sim.state") == 1)


def test_the_hall_is_drawn_without_webgl(browser, url):
    browser.do("open", url=url)
    assert browser.do("stage")
    colours = """(() => {
      const canvas = document.querySelector(".stage canvas");
      const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
      return new Set(new Uint32Array(pixels.buffer)).size;
    })()"""
    browser.do("rest", ms=300)
    assert browser.do("run", script=colours) > 10
    browser.do("click", role="button", name="Follow")
    browser.do("rest", ms=300)
    assert browser.do("run", script=colours) > 10


def test_every_kind_of_fault_can_be_injected(browser, url):
    browser.do("open", url=url)
    browser.do("view", name="Signals")
    options = (
        "[...document.querySelectorAll('.form select')[0].options].map((o) => o.value)"
    )
    assert browser.do("run", script=options) == list(FORMS)


def test_events_of_a_group_are_hidden_when_it_is_let_go(browser, url):
    browser.do("open", url=url)
    browser.do("view", name="Time")
    browser.do("click", role="button", name="Pause")
    browser.do("click", role="button", name="Resume")
    browser.do("wait", selector=".events li", text="running")
    browser.do("click", role="button", name="Commands and states")
    shown = (
        "[...document.querySelectorAll('.events li')].map((e) => e.innerText).join()"
    )
    assert "running" not in browser.do("run", script=shown)
    browser.do("click", role="button", name="Commands and states")
    browser.do("wait", selector=".events li", text="running")


def test_a_view_fits_a_phone(browser, url):
    browser.do("fresh", width=390, height=844)
    browser.do("open", url=url)
    for name in VIEWS:
        browser.do("view", name=name)
        wide = "document.scrollingElement.scrollWidth - innerWidth"
        assert browser.do("run", script=wide) <= 0, name


@pytest.mark.parametrize("width", [360, 390])
def test_the_bar_of_a_phone_has_two_rows(browser, url, width):
    browser.do("fresh", width=width, height=740)
    browser.do("open", url=url)
    browser.do("wait", selector=".owner", text="drives")
    longest = "An OPC UA client that has left drives"
    shown = f"""(() => {{
        document.querySelector(".control button[hidden]").hidden = false;
        document.querySelector(".owner").textContent = "{longest}";
        const middles = [...document.querySelectorAll(".bar *")]
            .filter((e) => e.matches("button, .chip, .owner") && e.checkVisibility())
            .map((e) => e.getBoundingClientRect()).map((b) => (b.top + b.bottom) / 2);
        return new Set(middles.map((m) => Math.round(m / 10))).size;
    }})()"""
    assert browser.do("run", script=shown) == 2


def text_of(path):
    return path.read_text(encoding="utf-8") if path.exists() else ""


def test_a_gain_is_tuned_by_keyboard_alone_saved_and_undone(
    browser, url, plant, daemon
):
    """Every answer of the daemon is waited for, so that each key acts on what is shown."""
    browser.do("open", url=url)
    browser.do("press", key="6")
    slider = "input[type='range'][aria-label='plant.controller.k_p']"
    browser.do("wait", selector=f"main[data-view='tune'] {slider}")
    said = "document.querySelector('[aria-label=Changes] [role=status]').textContent"

    def waits_for(text):
        done = (
            f"new Promise((r) => {{ const look = () => {said} === {text!r} ? r(true) :"
        )
        assert browser.do("run", script=f"{done} setTimeout(look, 50); look(); }})")

    waits_for("As configured.")
    browser.do("run", script=f'document.querySelector("{slider}").focus()')
    browser.do("press", key="ArrowRight")
    waits_for("1 differs from the configuration.")
    browser.do("click", role="button", name="Save as patch")
    plant.wait(
        lambda: "controller.k_p" in text_of(daemon.folder / "patches" / "tuned.yaml")
    )
    browser.do(
        "run",
        script="document.querySelector(\"[aria-keyshortcuts='Control+Z']\").focus()",
    )
    browser.do("press", key="Enter")
    waits_for("As configured.")
    assert browser.do("errors") == []


def test_k_om_is_chosen_by_name_and_exclusive_mode_switched(browser, url):
    browser.do("open", url=url)
    browser.do("press", key="6")
    group = "document.querySelector(\"[aria-label='Group of parameters']\")"
    gain = "kinematics.rotation_gain"
    browser.do(
        "wait", selector="main[data-view='tune'] [aria-label='plant.controller.k_p']"
    )
    browser.do(
        "run",
        script=f"{group}.value = 'Geometry'; {group}.dispatchEvent(new Event('change'))",
    )

    def entered(label, value, kind="input"):
        field = f"document.querySelector(\"main {kind}[aria-label='{label}']\")"
        event = f"{field}.dispatchEvent(new Event('change'))"
        browser.do("run", script=f"{field}.value = '{value}'; {event}")

    def shown(label, value):
        field = (
            f"document.querySelector(\"input[aria-label='{label}, exactly']\").value"
        )
        done = f"new Promise((r) => {{ const look = () => {field} === '{value}' ? r(true) :"
        assert browser.do("run", script=f"{done} setTimeout(look, 50); look(); }})")

    entered(f"{gain}, by name", "tile", "select")
    shown(gain, "1.052")
    entered(f"{gain}, by name", "geometric_skid", "select")
    shown(gain, "")
    entered("plant.exclusive_twist, exactly", "1")
    shown("plant.exclusive_twist", "1")
    browser.do("click", role="button", name="Reset all")
    shown("plant.exclusive_twist", "0")
    assert browser.do("errors") == []


def test_a_view_that_opens_shows_nothing_that_was_read_for_another_one(
    browser, url, plant
):
    """Drive is left while the wheels turn; when Tune opens, they have stood for long."""
    browser.do("open", url=url)
    browser.do("take")
    browser.do("down", key="ArrowUp")
    plant.wait(lambda: plant.value("wheel.fl.speed_rpm") > 10)
    browser.do("view", name="Time")
    browser.do("up", key="ArrowUp")
    plant.wait(lambda: abs(plant.value("wheel.fl.speed_rpm")) < 0.01)
    tick = plant.value("sim.tick")
    # longer than Tune looks back
    plant.wait(lambda: plant.value("sim.tick") > tick + 6000)
    browser.do("view", name="Tune")
    path = "document.querySelector('path.speed_rpm').getAttribute('d')"
    once = f"(r) => {{ const look = () => ({path} ?? '').includes('L') ? r({path}) :"
    drawn = browser.do(
        "run", script=f"new Promise({once} setTimeout(look, 50); look(); }})"
    )
    heights = {float(point.split(",")[1]) for point in re.split("[ML]", drawn) if point}
    assert all(abs(height - 100) < 1 for height in heights), heights


_PLAIN_HTTP = """
Object.defineProperty(navigator, "clipboard", { value: undefined }); window.copied = "";
document.addEventListener("copy", () => (window.copied = getSelection().toString()))
"""


def chosen(browser, label, option):
    script = f"""const select = document.querySelector('[aria-label="{label}"]');
    select.value = [...select.options].find((o) => o.text === '{option}').value;
    for (const kind of ["input", "change"]) select.dispatchEvent(new Event(kind))"""
    browser.do("run", script=script)


def becomes(browser, script, expected):
    """Wait until what a script gives is as expected."""
    look = f"""new Promise((done) => {{ const end = Date.now() + 60000, look = () => {{
      const now = {script};
      now === {expected} || Date.now() > end ? done(now) : setTimeout(look, 50); }}; look(); }})"""
    assert browser.do("run", script=f"{look}.then((now) => now === {expected})"), script


def test_a_paused_plot_is_read_at_a_cursor_that_keys_move(browser, url):
    browser.do("open", url=url)
    browser.do("view", name="Watch")
    assert browser.do(
        "run", script="document.querySelector('[aria-label=Cursor]').hidden"
    )
    becomes(
        browser, "/[0-9]/.test(document.querySelector('.legend b').textContent)", "true"
    )
    browser.do("click", role="button", name="Pause")
    browser.do("to", name="Cursor")
    moment = "document.querySelector('.moment').textContent"
    last = browser.do("run", script=moment)
    browser.do("press", key="ArrowLeft")
    becomes(browser, f"parseFloat({moment}) < {float(last.split()[0])}", "true")
    browser.do("press", key="Home")
    becomes(browser, "document.querySelector('[aria-label=Cursor]').value", "'0'")
    assert browser.do("run", script=moment) != last
    browser.do("click", role="button", name="Resume")
    assert browser.do(
        "run", script="document.querySelector('[aria-label=Cursor]').hidden"
    )
    assert browser.do("errors") == []


_STRETCHES = """[...document.querySelectorAll(".plot")].map((plot) =>
    [...plot.getAttribute("aria-label").matchAll(/-?[\\d.]+(?= s)/g)].map(Number))"""


def test_fingers_stop_the_plots_stretch_them_and_draw_them_along(browser, url, plant):
    browser.do("fresh", width=390, height=844, touch=True)
    plant.wait(lambda: plant.value("sim.tick") > 12_000)  # seconds to look back at
    browser.do("open", url=url)
    browser.do("view", name="Watch")
    becomes(
        browser, "/[0-9]/.test(document.querySelector('.legend b').textContent)", "true"
    )
    browser.do("fingers", selector=".plot .u-over", begin=[0.4, 0.6], end=[0.1, 0.9])
    browser.do("wait", selector="button", text="Resume")
    (low, high), other = browser.do("run", script=_STRETCHES)
    assert 0 < high - low < 10  # of 20 s
    assert other == [low, high]
    browser.do("fingers", selector=".plot .u-over", begin=[0.8], end=[0.3])
    (low_then, high_then), _ = browser.do("run", script=_STRETCHES)
    assert low_then > low
    assert high_then - low_then == pytest.approx(high - low, abs=0.02)
    browser.do("click", role="button", name="Resume")
    assert browser.do("errors") == []


def test_a_stretch_that_the_mouse_marks_is_shown_in_all_plots_and_stays(browser, url):
    browser.do("open", url=url)
    browser.do("view", name="Watch")
    becomes(
        browser, "/[0-9]/.test(document.querySelector('.legend b').textContent)", "true"
    )
    browser.do("mark", selector=".plot .u-over", begin=0.5, end=0.75)
    browser.do("wait", selector="button", text="Resume")
    (low, high), other = browser.do("run", script=_STRETCHES)
    assert high - low == pytest.approx(5, abs=0.5)  # a quarter of 20 s
    assert other == [low, high]


def test_plots_are_as_they_were_after_a_reload_and_states_have_names(browser, url):
    browser.do("open", url=url)
    browser.do("view", name="Watch")
    browser.do("fill", label="Find a signal", text="sim.state")
    browser.do("click", role="button", name="sim.state")
    state = "document.querySelector('b[data-name=\"sim.state\"]')?.textContent"
    becomes(browser, state, "'running'")
    browser.do("open", url=url)
    browser.do("view", name="Watch")
    becomes(browser, state, "'running'")
    browser.do(
        "run",
        script='localStorage.setItem(\'watch\', \'{"groups": [[1], ["gone"]], "windowS": 7}\')',
    )
    browser.do("open", url=url)
    browser.do("view", name="Watch")
    browser.do("wait", selector=".drop")
    assert browser.do("run", script="document.querySelectorAll('.plot').length") == 0
    assert browser.do("errors") == []


def test_signals_that_are_not_good_are_found_and_copied(browser, url):
    shown = "[...document.querySelectorAll('tbody tr')].filter((e) => !e.hidden).length"
    browser.do("open", url=url)
    browser.do("view", name="Signals")
    everything = browser.do("run", script=shown)
    browser.do("click", role="button", name="Force battery.voltage_v")
    browser.do("type", text="21.2512345")
    browser.do("press", key="Enter")
    chosen(browser, "Signals shown", "forced")
    becomes(browser, shown, "1")
    browser.do(
        "run",
        script="navigator.clipboard.writeText = async (text) => { window.copied = text }",
    )
    browser.do("click", role="button", name="Copy the values shown")
    becomes(browser, "window.copied", "'battery.voltage_v\\t21.2512345\\tV\\tForced'")
    browser.do("run", script=_PLAIN_HTTP)
    browser.do("click", role="button", name="Copy the values shown")
    becomes(browser, "window.copied", "'battery.voltage_v\\t21.2512345\\tV\\tForced'")
    browser.do("click", role="button", name="Release battery.voltage_v")
    becomes(browser, shown, "0")
    chosen(browser, "Signals shown", "all signals")
    becomes(browser, shown, str(everything))


def test_events_are_found_by_text_and_severity(browser, url):
    shown = "document.querySelectorAll('.events li:not(.note)').length"
    browser.do("open", url=url)
    browser.do("view", name="Time")
    browser.do("click", role="button", name="Pause")
    browser.do("click", role="button", name="Resume")
    browser.do("wait", selector=".events li", text="running")
    browser.do("fill", label="Find an event", text="no event says this")
    becomes(browser, shown, "0")
    browser.do("fill", label="Find an event", text="RUNNING")
    becomes(browser, f"{shown} > 0", "true")
    chosen(browser, "Severity", "errors only")
    becomes(browser, shown, "0")


def test_pace_and_time_of_a_step_are_seen_on_a_phone(browser, url):
    browser.do("fresh", width=390, height=844)
    browser.do("open", url=url)
    browser.do("view", name="Time")
    pace = "document.querySelector('[aria-label=Clock] dd')?.textContent"
    becomes(browser, f"parseFloat({pace}) > 0.2", "true")
    browser.do("wait", selector="[aria-label=Clock] dd", text="1 ms")
    hidden = "!document.querySelector('.figures').checkVisibility()"
    assert browser.do("run", script=hidden)  # of the bar: no room for it there

"""Nothing moves without a hand: what is gone, hidden or frozen holds nothing, and keys stop."""

import pytest

from tests.page.rig import RUNNING, SAFE, reset

pytestmark = pytest.mark.page
PAD = """window.pad = {
  connected: true, index: 0, id: "pad", axes: [0, %s],
  get timestamp() { return %s; },
}"""
AHEAD, FROZEN, AT_REST = (
    PAD % (-0.8, "performance.now()"),
    PAD % (-0.8, "1"),
    PAD % (0, "performance.now()"),
)
HIDDEN = """Object.defineProperty(document, "hidden", {value: %s, configurable: true});
document.dispatchEvent(new Event("visibilitychange"))"""
ELSEWHERE = "document.hasFocus = () => %s"
FIELDS = """[...document.querySelectorAll("main input, main select, main textarea")]
  .filter((field) => field.checkVisibility() && !field.disabled && field.type !== "color")
  .map((field) => field.tagName + field.type).filter((kind, i, all) => all.indexOf(kind) === i)"""
FOCUS = """[...document.querySelectorAll("main input, main select, main textarea")]
  .find((field) => field.checkVisibility() && !field.disabled
    && field.tagName + field.type === "%s").focus()"""
VIEWS = ("Drive", "Watch", "Signals", "Time", "Diagnosis", "Tune")


@pytest.fixture
def driver(browser, url):
    browser.do("open", url=url)
    browser.do("take")
    return browser


def ahead(browser, plant, pad=AHEAD):
    """Let the stick go, then push it ahead until the robot is commanded."""
    browser.do("run", script=AT_REST)
    browser.do("looked")
    browser.do("run", script=pad)
    plant.wait(lambda: plant.value("twist.linear_m_s") > 0.1)


def stays(browser, plant, ms=400):
    """What is commanded is zero and stays so."""
    plant.wait(lambda: plant.command() == 0.0)
    browser.do("rest", ms=ms)
    assert plant.command() == 0.0


@pytest.mark.parametrize(
    ("gone", "back"),
    [
        ("window.pad = null", AHEAD),
        ("window.pad.connected = false", AHEAD),
        (FROZEN, AHEAD),
        (HIDDEN % "true", HIDDEN % "false"),
        (ELSEWHERE % "false", ELSEWHERE % "true"),
    ],
    ids=["unplugged", "disconnected", "frozen", "hidden", "unfocused"],
)
def test_a_gamepad_that_is_gone_holds_nothing_until_its_stick_was_let_go(
    driver, plant, gone, back
):
    """Before, the robot went on for ever with the command that was held last."""
    ahead(driver, plant)
    driver.do("run", script=gone)
    stays(driver, plant)
    driver.do("run", script=back)
    stays(driver, plant)
    ahead(driver, plant)
    driver.do("run", script=AT_REST)
    plant.wait(lambda: plant.command() == 0.0)


def test_a_stick_that_is_held_while_control_is_taken_has_to_be_let_go_first(
    browser, url, plant
):
    browser.do("open", url=url)
    browser.do("run", script=AHEAD)
    browser.do("looked")
    browser.do("take")
    stays(browser, plant)
    ahead(browser, plant)


def test_s_ends_what_the_mouse_and_the_gamepad_hold(driver, plant):
    """Before, the next movement of a held stick drove again."""
    driver.do("grab", selector=".stick", dy=-0.3)
    plant.wait(lambda: plant.value("twist.linear_m_s") > 0.1)
    driver.do("press", key="s")
    plant.wait(lambda: plant.command() == 0.0)
    driver.do("drag", selector=".stick", dy=-0.2)
    stays(driver, plant)
    driver.do("drop")
    ahead(driver, plant)
    driver.do("press", key="s")
    stays(driver, plant)


def test_esc_stops_with_the_focus_on_any_field_of_any_view(driver, plant):
    """Before, a slider, a list or a search that had the focus kept X, Esc, space and S."""
    seen = set()
    for view in VIEWS:
        driver.do("view", name=view)
        driver.do("rest", ms=300)
        for kind in driver.do("run", script=FIELDS):
            driver.do("run", script=FOCUS % kind)
            driver.do("press", key="Escape")
            plant.wait(lambda: plant.value("sim.state") == SAFE)
            reset(driver, plant)
            seen.add(kind)
    assert {
        "SELECTselect-one",
        "INPUTrange",
        "INPUTsearch",
        "INPUTnumber",
        "INPUTtext",
    } <= seen


@pytest.mark.parametrize(
    ("key", "view", "kind"),
    [
        ("x", "Drive", "INPUTrange"),
        ("x", "Drive", "SELECTselect-one"),
        ("x", "Time", "INPUTnumber"),
        (" ", "Drive", "INPUTrange"),
        (" ", "Time", "INPUTnumber"),
    ],
)
def test_x_and_space_stop_where_they_mean_nothing_else(driver, plant, key, view, kind):
    driver.do("view", name=view)
    driver.do("run", script=FOCUS % kind)
    driver.do("press", key=key)
    plant.wait(lambda: plant.value("sim.state") == SAFE)
    reset(driver, plant)


def test_esc_stops_out_of_a_dialogue(driver, plant):
    driver.do("run", script="document.querySelector('.wheel').focus()")
    driver.do(
        "run",
        script="""const dialog = document.body.appendChild(document.createElement("dialog"));
        const field = dialog.appendChild(document.createElement("input"));
        dialog.addEventListener("keydown", (event) => event.stopPropagation());
        dialog.showModal(); field.focus()""",
    )
    driver.do("press", key="Escape")
    plant.wait(lambda: plant.value("sim.state") == SAFE)
    driver.do("run", script="document.querySelector('dialog').remove()")
    reset(driver, plant)


def test_a_text_keeps_its_letters(driver, plant):
    driver.do("view", name="Signals")
    driver.do("run", script=FOCUS % "INPUTsearch")
    driver.do("type", text="max s")
    assert driver.do("run", script="document.activeElement.value") == "max s"
    assert plant.value("sim.state") == RUNNING


def test_arrows_drive_with_the_focus_on_the_speed_limit(driver, plant):
    """Before, they changed the limit, while those pressed before went on to drive."""
    driver.do("run", script="document.querySelector('.limit input').focus()")
    driver.do("down", key="ArrowUp")
    plant.wait(lambda: plant.value("twist.linear_m_s") > 0.1)
    assert (
        driver.do("run", script="document.querySelector('.limit input').value") == "50"
    )
    driver.do("up", key="ArrowUp")
    plant.wait(lambda: plant.command() == 0.0)
    driver.do("press", key="PageUp")
    assert (
        driver.do("run", script="document.querySelector('.limit input').value") != "50"
    )


def test_arrows_that_drive_go_on_to_drive_in_a_list(driver, plant):
    driver.do("down", key="ArrowUp")
    plant.wait(lambda: plant.value("twist.linear_m_s") > 0.1)
    driver.do("run", script="document.querySelector('.lights select').focus()")
    driver.do("down", key="ArrowLeft")
    plant.wait(lambda: plant.value("twist.angular_rad_s") > 0.1)
    assert plant.value("lights.command") == 0
    for key in ("ArrowUp", "ArrowLeft"):
        driver.do("up", key=key)
    plant.wait(lambda: plant.command() == 0.0)

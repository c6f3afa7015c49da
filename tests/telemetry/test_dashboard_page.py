"""The dashboard's page in a real browser, on a bus made for tests; conditions are waited for."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from playwright.sync_api import Browser, Locator, Page, ViewportSize, expect

from dbc.messages import Inhibit, Mode
from telemetry.dashboard.control import NO_WISH, Action, Wish
from tests.telemetry.chromium import WAIT_MS_MAX, headless_chromium
from tests.telemetry.dashboard_rig import TOKEN
from tests.telemetry.dashboard_served import Served

pytestmark = pytest.mark.wall_clock
expect.set_options(timeout=WAIT_MS_MAX)

PHONE = ViewportSize(width=390, height=844)
LOOK_MS = 20


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with headless_chromium(tmp_path_factory.mktemp("chromium")) as browser:
        yield browser


@pytest.fixture
def served() -> Iterator[Served]:
    with Served() as served:
        yield served


class Opened:
    """A page, and whatever it complained of."""

    def __init__(self, chromium: Browser, served: Served, token: str = TOKEN) -> None:
        self.complaints: list[str] = []
        self.asked: list[str] = []
        self.page: Page = chromium.new_page()
        self.page.set_default_timeout(WAIT_MS_MAX)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(served.url(token))

    def at(self, selector: str) -> Locator:
        return self.page.locator(selector)

    def wait_until_live(self) -> None:
        expect(self.at("#connection")).to_have_text("live")
        expect(self.at("body.stale")).to_have_count(0)


def wait_until(page: Page, condition: str) -> None:
    page.wait_for_function(condition, timeout=WAIT_MS_MAX)


def test_the_page_shows_the_car_and_asks_nobody_else_for_anything(
    chromium: Browser, served: Served
) -> None:
    served.car.wheel_speed_radps, served.car.wheel_rad = 10.0, 1.0
    opened = Opened(chromium, served)
    opened.wait_until_live()
    expect(opened.at("#vehicle")).to_have_text("tabby_evo")
    expect(opened.at("#mode")).to_have_text("MANUAL")
    expect(opened.at("#why")).to_contain_text("button")
    expect(opened.at("#wheel-text")).to_have_text("57° left")
    expect(opened.at("#throttle")).to_have_text("25 %")
    expect(opened.at("#speed")).to_have_text("10")
    expect(opened.at("#nodes li[data-node=Steering]")).to_have_attribute("data-is", "alive")
    expect(opened.at("#nodes li[data-node=Gateway]")).to_have_attribute("data-is", "missing")
    expect(opened.at("#load")).to_contain_text("frames/s")
    wait_until(opened.page, "document.getElementById('load-bar').clientWidth > 10")
    expect(opened.at("#driven")).not_to_have_text("0 m driven")
    expect(opened.at(".plot canvas")).to_have_count(3)
    expect(opened.at(".plot[data-signal^=STEER_STATUS] b")).to_contain_text("rad")
    expect(opened.at("#log")).to_contain_text("mode MANUAL")
    opened.at("#signal").select_option("BRAKE_STATUS.rear_wheel_speed_radps")
    expect(opened.at(".plot[data-signal*=rear_wheel] b")).to_contain_text("10")
    assert opened.complaints == []
    assert all(url.startswith(f"http://{served.host}/") for url in opened.asked)
    assert TOKEN not in opened.page.url
    opened.page.close()


def test_on_a_phone_nothing_is_wider_than_the_screen(chromium: Browser, served: Served) -> None:
    opened = Opened(chromium, served)
    opened.page.set_viewport_size(PHONE)
    opened.wait_until_live()
    for theme in ("dark", "bright"):
        if opened.at("html").get_attribute("data-theme") != theme:
            opened.at("#theme").click()
        wait_until(opened.page, "document.documentElement.scrollWidth <= innerWidth")
        box = opened.at("#emergency").bounding_box()
        assert box is not None and box["height"] >= 60 and box["width"] >= 280
    opened.page.close()


def test_a_silent_bus_and_codes_are_shown_as_such(chromium: Browser, served: Served) -> None:
    opened = Opened(chromium, served)
    opened.wait_until_live()
    served.car.is_silent = True
    expect(opened.at("#alarm")).to_contain_text("bus is silent")
    expect(opened.at("body.stale")).to_have_count(1)
    expect(opened.at("#mode")).to_have_text("NOT HEARD")
    expect(opened.at("#speed")).to_have_text("\N{EN DASH}")
    served.car.mode, served.car.inhibit = Mode.EMERGENCY, Inhibit.CODE_LATCHED
    served.car.has_er1, served.car.is_silent = True, False
    opened.wait_until_live()
    expect(opened.at("#mode")).to_have_attribute("data-mode", "EMERGENCY")
    expect(opened.at("#codes")).to_contain_text("ER1")
    expect(opened.at("#alarm")).to_be_hidden()
    opened.page.close()


def test_buttons_do_what_they_say(chromium: Browser, served: Served) -> None:
    opened = Opened(chromium, served)
    opened.wait_until_live()
    opened.at("#emergency").click()
    opened.at("[data-action=button]").click()
    expect(opened.at("[data-action=engage]")).to_be_disabled()
    served.car.mode = Mode.READY
    opened.at("[data-action=engage]").click()
    served.car.mode = Mode.EMERGENCY
    opened.at("[data-action=reset]").click()
    expect(opened.at("#log")).to_contain_text("reset asked for")
    assert served.controls.done == [
        Action.EMERGENCY_BRAKE, Action.BUTTON, Action.ENGAGE, Action.RESET,
    ]  # fmt: skip
    served.controls.refusal = "the car is moving"
    opened.at("[data-action=reset]").click()
    expect(opened.at("#refused")).to_have_text("the car is moving")
    opened.page.close()


def test_a_wrong_token_watches_only_until_the_right_one_is_given(
    chromium: Browser, served: Served
) -> None:
    opened = Opened(chromium, served, token="wrong")
    opened.wait_until_live()
    expect(opened.at("#refused")).to_contain_text("wrong token")
    expect(opened.at("#emergency")).to_be_disabled()
    expect(opened.at("[data-action=button]")).to_be_disabled()
    opened.page.evaluate("document.querySelector('#emergency').disabled = false")
    opened.at("#emergency").click()
    expect(opened.at("#refused")).to_contain_text("needs the token")
    assert served.controls.done == []
    opened.at("#token").fill(TOKEN)
    opened.at("#token-form button").click()
    expect(opened.at("#token-form")).to_be_hidden()
    opened.at("#emergency").click()
    expect(opened.at("#log")).to_contain_text("emergency brake asked for")
    assert served.controls.done == [Action.EMERGENCY_BRAKE]
    opened.page.close()


def test_driving_goes_on_as_long_as_the_pad_is_held(chromium: Browser, served: Served) -> None:
    opened = Opened(chromium, served)
    opened.wait_until_live()
    expect(opened.at("#token-form")).to_be_hidden()
    opened.at("#pad").scroll_into_view_if_needed()
    box = opened.at("#pad").bounding_box()
    assert box is not None
    mouse = opened.page.mouse
    mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] - 30)
    mouse.down()
    mouse.move(box["x"] + box["width"] / 4, box["y"] + box["height"] / 2)
    expect(opened.at("#pad-text")).to_contain_text("radius")
    wait_for_wish(opened.page, served, lambda wish: min(wish.speed_mps, wish.curvature_per_m) > 0)
    mouse.up()
    wait_until_let_go(opened.page, served)
    brake = opened.at("[data-hold*=brake]")
    brake.scroll_into_view_if_needed()
    brake.hover()
    mouse.down()
    wait_for_wish(opened.page, served, lambda wish: wish.brake_pedal_ratio == 0.6)
    mouse.up()
    wait_until_let_go(opened.page, served)
    opened.page.close()


def wait_for_wish(page: Page, served: Served, is_it: Callable[[Wish], bool]) -> None:
    """Waits until there has been such a wish: on a busy machine the dead-man may end it soon."""
    wait_for(page, lambda: any(map(is_it, list(served.controls.wishes))))


def wait_until_let_go(page: Page, served: Served) -> None:
    wait_for(page, lambda: served.controls.wishes[-1] == NO_WISH)
    served.controls.wishes.clear()


def wait_for(page: Page, is_so: Callable[[], bool]) -> None:
    """Waits for a condition here; the page goes on meanwhile."""
    for _ in range(WAIT_MS_MAX // LOOK_MS):
        if is_so():
            return
        page.wait_for_timeout(LOOK_MS)
    raise AssertionError("not in time")


def test_a_browser_says_that_all_is_old_and_reconnects_by_itself(chromium: Browser) -> None:
    served = Served()
    with served:
        opened = Opened(chromium, served)
        opened.wait_until_live()
    expect(opened.at("#connection")).to_have_text("stale")
    expect(opened.at("#alarm")).to_contain_text("is old")
    expect(opened.at("body.stale")).to_have_count(1)
    expect(opened.at("#emergency")).to_be_disabled()
    served.car.mode = Mode.READY
    with served:
        opened.wait_until_live()
        expect(opened.at("#mode")).to_have_text("READY")
        opened.at("#emergency").click()
        expect(opened.at("#log")).to_contain_text("emergency brake asked for")
        opened.page.close()
    assert opened.complaints == []

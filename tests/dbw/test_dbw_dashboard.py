"""`dbw dashboard` from its command line to a car that is driven by hand in a real browser."""

from __future__ import annotations

import re
import socket
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path

import pytest
from playwright.sync_api import Page, TimeoutError, expect

from canbus.bus import BusError
from dbw.main import main
from tests.dbw.test_dbw_wall import ATTEMPTS_MAX, skip_if_busy
from tests.telemetry.chromium import WAIT_MS_MAX, headless_chromium
from tests.telemetry.page_socket import Page as PageSocket
from tests.telemetry.page_socket import served

HERE_MS_MAX = 20_000
HERE_S_MAX = HERE_MS_MAX / 1e3
TOKEN = "a-token-for-tests-0815"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--interface", "virtual"], "a virtual bus lives inside one process"),
        (["--desk", "--gateway"], "--desk brings its own"),
        (["--channel", "vcan0", "--harness-channel", "vcan0"], "two buses are wanted"),
        (["--port", "70000"], "a whole number from 0 to 65535"),
        (["--foxglove", "x"], "a whole number from 0 to 65535"),
        (["--vehicle", "beetle"], "beetle"),
        (["--token-file", "no/such/folder/token"], "No such file"),
    ],
)
def test_a_mistake_is_one_clear_line(
    options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["dashboard", *options]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1


@pytest.mark.parametrize("options", [["--desk"], ["--channel", "no-such"]])
def test_garbage_is_collected_before_a_gateway_or_a_node_runs(
    options: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full collection of what is loaded takes nearly as long as a decision may be old."""
    done: list[str] = []

    def opened(setup: object) -> None:
        done.append("opened")
        raise BusError("far enough")

    def stack(**_: object) -> AbstractContextManager[None]:
        done.append("stack")
        return nullcontext()

    monkeypatch.setattr("runtime.realtime.keep_collections_short", lambda: done.append("collected"))
    monkeypatch.setattr("runtime.launch.InProcessStack", stack)
    monkeypatch.setattr("dbw.dashboard_server.open_dashboard", opened)
    monkeypatch.setattr("runtime.realtime.apply_realtime", lambda _: None)
    assert main(["dashboard", *options]) == 2
    assert done[0] == "collected" and done[-1] == "opened"


def test_a_token_that_is_too_short_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "token").write_text("short\n")
    assert main(["dashboard", "--desk", "--token-file", str(tmp_path / "token")]) == 2
    assert "at least 16 characters" in capsys.readouterr().err


def test_a_token_file_is_made_once_and_for_its_owner_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "token"
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        options = ["--channel", "no-such", "--port", port, "--token-file", str(path)]
        tokens = set()
        for _ in range(2):
            assert main(["dashboard", *options]) == 2
            assert f"cannot listen on 127.0.0.1 port {port}" in capsys.readouterr().err
            tokens.add(path.read_text())
    assert len(tokens) == 1 and path.stat().st_mode & 0o777 == 0o600


def test_the_demo_shows_a_page_in_wall_time_alone(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--dashboard"]) == 2
    assert "--dashboard needs --realtime" in capsys.readouterr().err


@pytest.mark.wall_clock
def test_a_page_beside_the_demo_shows_its_drive_and_may_not_take_it_over(tmp_path: Path) -> None:
    for attempt in range(ATTEMPTS_MAX):
        out, said = tmp_path / str(attempt), tmp_path / f"{attempt}.txt"
        demo = ["demo", "--realtime", "--dashboard", "0", "--distance-m", "20", "--out", str(out)]
        try:
            with PageSocket(demo, said) as page:
                try:
                    watch_the_drive(page)
                finally:
                    page.wait()  # it says why it ended early
        except AssertionError:
            skip_if_busy(attempt, said.read_text() + " ".join(page.log))
        else:
            assert (out / "report.json").exists()
            return


def watch_the_drive(page: PageSocket) -> None:
    """Until half of it is done."""
    page.until(lambda: page.shown.get("mode") == "AUTOMATIC", HERE_S_MAX)
    page.until(lambda: (page.shown["speed_mps"] or 0.0) > 2.0, HERE_S_MAX)
    page.say("engage")  # the demo's planner has the gateway
    page.until(lambda: "not possible" in page.refused, HERE_S_MAX)
    page.until(lambda: page.shown["driven_m"] > 10.0, HERE_S_MAX)


@contextmanager
def desk(folder: Path) -> Iterator[str]:
    """A car on a desk in a process of its own; the address of its page, with the token."""
    (folder / "token").write_text(TOKEN)
    arguments = ["dashboard", "--desk", "--port", "0", "--token-file", str(folder / "token")]
    with served(arguments, folder / "desk.txt") as (_, found):
        yield found["url"]


@pytest.mark.wall_clock
def test_a_car_on_a_desk_is_engaged_driven_and_braked_by_the_page(tmp_path: Path) -> None:
    with headless_chromium(tmp_path) as chromium:
        for attempt in range(ATTEMPTS_MAX):
            with desk(tmp_path) as url:
                page = chromium.new_page()
                page.set_default_timeout(HERE_MS_MAX)
                page.goto(url, timeout=WAIT_MS_MAX)
                try:
                    drive_and_brake(page)
                except (AssertionError, TimeoutError):
                    skip_if_busy(attempt, page.inner_text("#log"))
                else:
                    return
                finally:
                    page.close()


def drive_and_brake(page: Page) -> None:
    """From MANUAL through a drive and an emergency brake back to MANUAL."""
    mode, why, speed = (page.locator(f"#{name}") for name in ("mode", "why", "speed"))
    expect(mode).to_have_text("MANUAL", timeout=WAIT_MS_MAX)
    expect(why).to_have_text(re.compile("button|latched"), timeout=HERE_MS_MAX)
    if "latched" in why.inner_text():  # a machine that was busy while the car woke up
        page.click("[data-action=reset]")
    expect(why).to_contain_text("button", timeout=HERE_MS_MAX)
    page.click("[data-action=button]")
    expect(mode).to_have_text("READY", timeout=HERE_MS_MAX)
    page.click("[data-action=engage]")
    expect(mode).to_have_text("AUTOMATIC", timeout=HERE_MS_MAX)
    page.locator("#pad").scroll_into_view_if_needed()
    box = page.locator("#pad").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"]
    page.mouse.move(x, y - 30)
    page.mouse.down()
    page.mouse.move(x, y - box["height"] / 2)
    expect(speed).to_have_text(re.compile(r"^([4-9]\.|1\d)"), timeout=HERE_MS_MAX)
    page.mouse.up()
    page.click("#emergency")
    expect(mode).to_have_text("EMERGENCY", timeout=HERE_MS_MAX)
    expect(speed).to_have_text("0.0", timeout=HERE_MS_MAX)
    expect(page.locator("#codes")).to_contain_text("ER1", timeout=HERE_MS_MAX)
    page.click("[data-action=reset]")
    expect(mode).to_have_text("MANUAL", timeout=HERE_MS_MAX)

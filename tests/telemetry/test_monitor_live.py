"""The screen of `dbw monitor --live` in virtual time, read as text."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest

from canbus.heard import EXTENDED_FLAG, Heard
from canbus.timing import frame_bits
from dbc.messages import (
    SPECS,
    Inhibit,
    Mode,
    MonitorReason,
    NodeState,
    SafetyVerdict,
    SteerDriver,
    SupervisorState,
    Verdict,
)
from telemetry.monitor.braille import curve
from telemetry.monitor.model import ROWS_MAX, BusModel, Presence, Row
from telemetry.monitor.screen import CHANGED_NS, Screen
from telemetry.monitor.selection import Selection, select
from telemetry.monitor.style import CHANGED, plain_text
from telemetry.monitor.view import HELP, View
from tests.telemetry.monitored import MS, S, heard, heartbeat, interpreter, own, steering

BITRATE_BPS = 500_000
OFFSET_NS = 77 * S
"""From the frames' clock to the monotonic one."""
CYCLE_NS = SPECS[0x182].cycle_ns
TIMEOUT_NS = SPECS[0x182].timeout_ns


class Watched:
    """A model, a view and a screen, and the time on the frames' clock."""

    def __init__(self, selection: Selection | None = None, channels: tuple[str, ...] = ("can0",)):
        self.model = BusModel(interpreter(), channels)
        self.view = View(selection or Selection())
        self.screen = Screen(self.model, self.view, BITRATE_BPS)
        self.now_ns = 0

    def feed(self, *frames: Heard) -> None:
        self.model.feed(frames, OFFSET_NS)
        self.now_ns = max([self.now_ns, *(frame.time_ns for frame in frames)])

    def steer_for(self, duration_ns: int, start_counter: int = 0) -> None:
        """STEER_STATUS as it should be, drawn five times a second."""
        end_ns = self.now_ns + duration_ns
        number = start_counter
        while self.now_ns < end_ns:
            self.feed(steering(0.1, number % 15, self.now_ns + CYCLE_NS))
            number += 1
            if number % 20 == 0:
                self.model.tick(self.now_ns + OFFSET_NS)

    def lines(self, width: int = 160, height: int = 60, **given: object) -> list[str]:
        lines = self.screen.lines(width, height, self.now_ns + OFFSET_NS, **given)  # type: ignore[arg-type]
        assert len(lines) == height
        texts = [plain_text(line) for line in lines]
        assert all(len(text) <= width for text in texts)
        return texts

    def line(self, part: str, width: int = 160) -> str:
        return next(line for line in self.lines(width) if part in line)

    def row(self, can_id: int = 0x182, channel: str = "can0") -> Row:
        return self.model.rows[channel, can_id]

    def press(self, *keys: str) -> None:
        for key in keys:
            self.view.press(key, self.model, self.now_ns + OFFSET_NS)


def shown_ids(watched: Watched) -> list[str]:
    rows = watched.view.rows(watched.model, watched.now_ns + OFFSET_NS)
    return [f"{row.word:03X}" for row in rows]


def test_messages_with_a_cycle_are_missing_before_anything_is_heard() -> None:
    watched = Watched()
    cyclic = [spec for spec in SPECS.values() if spec.cycle_ns]
    assert len(watched.model.rows) == len(cyclic)
    assert " missing " in watched.line("STEER_STATUS")
    assert "Steering missing" in "\n".join(watched.lines())


@pytest.mark.parametrize(
    ("age_ns", "presence"),
    [
        (0, Presence.ALIVE),
        (2 * CYCLE_NS, Presence.ALIVE),
        (2 * CYCLE_NS + 1, Presence.LATE),
        (TIMEOUT_NS, Presence.LATE),
        (TIMEOUT_NS + 1, Presence.MISSING),
    ],
)
def test_a_message_is_alive_late_and_missing_by_the_dbcs_times(
    age_ns: int, presence: Presence
) -> None:
    watched = Watched()
    watched.feed(steering(time_ns=S))
    assert watched.row().presence(S + OFFSET_NS + age_ns) is presence


def test_a_message_without_a_cycle_is_an_event_however_old() -> None:
    watched = Watched()
    watched.feed(heard("001#"), heard("7DF#00"))
    for can_id in (0x001, 0x7DF):
        assert watched.row(can_id).presence(OFFSET_NS + 1_000 * S) is Presence.EVENT


def test_a_row_tells_age_rate_and_verdict() -> None:
    watched = Watched()
    watched.steer_for(3 * S)
    watched.now_ns += 7 * MS
    assert watched.row().rate_hz == pytest.approx(100)
    assert "182 STEER_STATUS" in watched.line("STEER_STATUS")
    assert " alive         7  100.0/100       10 14 ok                 0 " in watched.line(
        "STEER_STATUS"
    )
    assert "steering_wheel_angle_rad=0.1 rad  applied_steering" in watched.line("STEER_STATUS", 200)


def test_the_rate_falls_to_nothing_when_frames_stay_away() -> None:
    watched = Watched()
    watched.steer_for(3 * S)
    for _ in range(4):
        watched.now_ns += S
        watched.lines()
    assert watched.row().rate_hz == 0.0


def test_a_slow_message_has_its_rate_from_the_frames_and_not_from_the_drawing() -> None:
    watched = Watched()
    for number in range(6):
        watched.feed(heard("7DF#00", number * 2 * S))
        watched.lines()
    assert watched.row(0x7DF).rate_hz == pytest.approx(0.5)


def test_faults_and_the_longest_gap_stay_until_they_are_reset() -> None:
    watched = Watched()
    watched.steer_for(200 * MS)
    watched.feed(steering(counter=9, time_ns=watched.now_ns + TIMEOUT_NS + 5 * MS))
    row = watched.row()
    assert row.protection is not None
    assert (row.protection.faults, row.gap_ns_max, row.timeouts) == (1, TIMEOUT_NS + 5 * MS, 1)
    assert "65 9 out of sequence     1 " in watched.line("STEER_STATUS")
    watched.press("r")
    assert (row.protection.faults, row.gap_ns_max, row.timeouts) == (0, 0, 0)


def test_a_frame_with_a_wrong_crc_shows_as_such() -> None:
    watched = Watched()
    watched.feed(steering(), steering()._replace(data=bytes(8)))
    assert "CRC wrong             1 00 00 00" in watched.line("STEER_STATUS")


def test_a_byte_that_changed_is_marked_even_if_it_changed_back_between_two_pictures() -> None:
    watched = Watched()
    watched.feed(heard("7DF#0011"))
    watched.lines()
    watched.feed(heard("7DF#0022"), heard("7DF#0011"))

    def marked() -> list[str]:
        lines = watched.screen.lines(160, 60, watched.now_ns + OFFSET_NS)
        line = next(line for line in lines if "7DF" in plain_text(line))
        return [span.text for span in line if span.style is CHANGED]

    assert marked() == ["11 "]
    watched.now_ns += CHANGED_NS
    assert marked() == []


def test_load_is_the_exact_bits_of_a_second() -> None:
    watched = Watched()
    frames = [steering(0.01 * n, n % 15, n * 10 * MS) for n in range(101)]
    bits = sum(frame_bits(frame.frame()) for frame in frames[1:])
    watched.feed(frames[0])
    watched.lines()
    for frame in frames[1:]:
        watched.feed(frame)
    line = watched.line("load")
    assert watched.model.channels["can0"].bits_per_s == pytest.approx(bits)
    assert f"load {bits / BITRATE_BPS:6.1%}  most {bits / BITRATE_BPS:6.1%}" in line
    assert "100 frames/s" in line


def test_fd_and_error_frames_are_counted_and_not_in_the_load() -> None:
    watched = Watched()
    watched.feed(heard("123##0" + "00" * 12), heard("20000040#0000000000000000"))
    channel = watched.model.channels["can0"]
    assert (channel.bits, channel.fd_frames, channel.errors, channel.frames) == (0, 1, 1, 1)
    text = "\n".join(watched.lines())
    assert "1 error frames" in text and "1 FD frames, not in load" in text
    assert "ERRORFRAME" in text and "BUS-OFF" in text


def supervisor(mode: Mode, *, er4: bool = False) -> Heard:
    message = SupervisorState(
        mode=mode, steering_authorised=True, throttle_authorised=False, brake_authorised=False,
        er0=False, er1=False, er2=False, er3=False, er4=er4, er5=False, er6=False, reset_epoch=0,
        decision_age_ms_max=85.0, inhibit=Inhibit.CODE_LATCHED if er4 else Inhibit.NONE,
    )  # fmt: skip
    return own("SUPERVISOR_STATE", message)


def test_mode_verdict_codes_and_nodes_are_told() -> None:
    watched = Watched()
    verdict = SafetyVerdict(
        verdict=Verdict.BRAKE, reason=MonitorReason.SPEED, identifier=0, value=1200
    )
    driver = SteerDriver(
        torque_nm=0.0, driver_active=False, node_state=NodeState.EMERGENCY, er0=False, er1=False,
        er2=False, er3=False, er4=True, er5=False, er6=False, present_codes=0,
    )  # fmt: skip
    watched.feed(
        supervisor(Mode.EMERGENCY, er4=True), own("SAFETY_VERDICT", verdict),
        own("STEER_DRIVER", driver), heartbeat(), steering(),
    )  # fmt: skip
    text = "\n".join(watched.lines(width=200))
    assert "mode EMERGENCY (CODE_LATCHED)   verdict BRAKE (SPEED)   codes ER4" in text
    assert "Steering OPERATIONAL EMERGENCY ER4" in text
    assert "Throttle missing" in text
    watched.now_ns += 75 * MS
    text = "\n".join(watched.lines(width=200))
    assert "mode ?" in text and "codes none" in text
    assert "Steering OPERATIONAL EMERGENCY ER4 without STEER_STATUS" in text


def test_what_the_kernel_lost_and_what_became_of_a_channel_is_told() -> None:
    watched = Watched()
    assert "lost" not in "\n".join(watched.lines())
    text = "\n".join(watched.lines(lost=7, note="can0: gone"))
    assert "7 frames lost, not read in time" in text and "can0: gone" in text


def test_several_channels_have_a_load_and_rows_each() -> None:
    watched = Watched(channels=("can0", "can1"))
    watched.feed(steering(), heard("123#00", channel="can1"))
    assert sum("load" in line for line in watched.lines()) == 2
    assert watched.line(" 123 ").startswith("can1")
    assert ("can1", 0x182) not in watched.model.rows  # nothing of ours was heard there
    watched.feed(steering()._replace(channel="can1"))
    assert watched.row(0x183, "can1").presence(OFFSET_NS) is Presence.MISSING


def test_the_filter_finds_ids_messages_nodes_and_signals_while_it_is_typed() -> None:
    watched = Watched()
    watched.press("/", *"torque")
    assert shown_ids(watched) == ["282"]
    assert "filter: torque_" in watched.lines()[-1]
    watched.press("q", "backspace", "enter")
    assert not watched.view.is_ended and watched.view.filter == "torque"
    assert "filter 'torque'" in watched.lines()[-1]
    watched.press("/", "esc")
    assert len(shown_ids(watched)) > 10
    watched.press("/", *"brakeservo", "enter")
    assert shown_ids(watched) == ["184", "284", "704"]
    watched.press("esc", "/", *"70", "enter")
    assert shown_ids(watched) == ["701", "702", "703", "704", "705", "706"]


def test_the_command_lines_selection_holds_for_rows() -> None:
    catalogue = interpreter().catalogue
    watched = Watched(select(catalogue, (), messages=["STEER_STATUS"]))
    watched.feed(heard("7DF#00"), steering())
    assert shown_ids(watched) == ["182"]
    assert watched.model.channels["can0"].frames == 2  # load and rates are of all


def test_rows_are_sorted_as_wanted() -> None:
    watched = Watched()
    watched.steer_for(3 * S)
    watched.lines()
    orders = []
    for _ in range(5):
        orders.append(shown_ids(watched))
        watched.press("s")
    by_id, by_name, by_node, by_rate, by_trouble = orders
    assert by_id == sorted(by_id)
    assert by_name[0] == "204" and by_node[0] == "184"
    assert by_rate[0] == "182" and by_trouble[-1] == "182"
    assert watched.view.sort.value == "id"


def test_a_pause_stops_the_picture_and_not_the_counting() -> None:
    watched = Watched()
    watched.feed(heard("7DF#01"))
    before = watched.line("7DF")
    watched.press(" ")
    watched.lines()
    watched.feed(heard("7DF#02"))
    assert watched.line("7DF") == before and "PAUSED" in watched.lines()[-1]
    watched.press(" ")
    assert "02" in watched.line("7DF")
    assert watched.row(0x7DF).count == 2


def test_the_chosen_row_moves_stays_in_sight_and_is_told_in_full() -> None:
    watched = Watched()
    watched.feed(steering(0.25), heartbeat())
    watched.press("down")
    assert watched.view.chosen == ("can0", 0x181)
    watched.press("down")
    assert "STEER_STATUS of Steering" in "\n".join(watched.lines())
    assert "steering_wheel_angle_rad=0.25 rad" in "\n".join(watched.lines(80, 24))
    watched.press("end")
    assert watched.view.chosen == ("can0", 0x706)
    assert "706 GATEWAY_HEARTBEAT" in "\n".join(watched.lines(120, 16))
    watched.press("home", "up", "k")
    assert watched.view.chosen == ("can0", 0x181)
    watched.press("pgdn", "pgup", "j")
    assert watched.view.chosen == ("can0", 0x182)


def test_signals_of_the_chosen_row_are_plotted_one_after_the_other() -> None:
    watched = Watched()
    watched.press("down", "down", "g")
    assert "no value yet" in "\n".join(watched.lines())
    for number in range(100):
        watched.feed(steering(number / 100, number % 15, number * CYCLE_NS))
    text = "\n".join(watched.lines())
    assert "STEER_STATUS.steering_wheel_angle_rad  last 20 s  now 0.99" in text
    assert any("\u2801" <= character <= "\u28ff" for character in text)
    watched.press("g")
    assert watched.model.plotted is not None
    assert watched.model.plotted[1] == "applied_steering_wheel_angle_rad"
    assert len(watched.model.samples) == 0
    watched.press("g")
    assert watched.model.plotted is None
    watched.press("g", "esc")
    assert watched.model.plotted is None


def test_help_explains_every_key_and_esc_leaves_it() -> None:
    watched = Watched()
    watched.press("h")
    assert watched.lines()[1 : 1 + len(HELP)] == list(HELP)
    watched.press("esc")
    assert "Keys" not in watched.lines()[0]
    watched.press("m")
    assert shown_ids(watched) == [] and "missing ones hidden" in watched.lines()[-1]
    watched.press("down", "tab", "q")
    assert watched.view.is_ended


@pytest.mark.parametrize(("width", "height"), [(160, 50), (80, 24), (20, 5), (1, 1), (400, 100)])
def test_a_picture_of_every_size_fits(width: int, height: int) -> None:
    watched = Watched()
    watched.steer_for(S)
    watched.feed(heard("18FEF1FE#0102"), heard("123##0" + "AB" * 64), heard("182#R8"))
    watched.press("down", "down", "g")
    watched.steer_for(S)
    watched.lines(width, height)


def test_memory_is_bounded_whatever_comes() -> None:
    chance = random.Random(1)
    watched = Watched()
    watched.press("down", "down", "g")
    for number in range(3 * ROWS_MAX):
        word = chance.getrandbits(29) | EXTENDED_FLAG
        watched.feed(Heard(number * MS, "can0", word, b"", 0))
    for number in range(5_000):
        watched.feed(steering(counter=number % 15, time_ns=(10_000 + 10 * number) * MS))
        if number % 100 == 0:
            watched.model.tick(watched.now_ns + OFFSET_NS)
    model = watched.model
    assert len(model.rows) == ROWS_MAX
    assert model.unlisted > 0 and "frames without a row" in "\n".join(watched.lines())
    assert len(model.samples) == model.samples.maxlen
    assert len(model.channels["can0"]._samples) < 5


def test_a_curve_joins_its_points_and_leaves_out_what_is_not_there() -> None:
    nan = float("nan")
    flat = curve([(0, 0), (1, 0), (2, 0), (3, 0)], 2, 1, (0, 4), (0, 1))
    assert flat == ["\u28c0\u28c0"]
    step = curve([(0, 0), (1, 1)], 1, 2, (0, 2), (0, 1))
    assert step == ["\u28b8", "\u28f8"]
    assert curve([(0, nan), (9, 0)], 1, 1, (0, 4), (0, 1)) == ["\u2800"]
    assert curve([(0, 5)], 1, 1, (0, 1), (5, 5)) != ["\u2800"]  # a constant is drawn in the middle


def test_offsets_between_the_clocks_do_not_show() -> None:
    """The system's clock is set by an hour: the frames' stamps jump, ages and gaps do not."""
    watched = Watched()
    hour_ns = 3_600 * S
    watched.feed(steering(counter=0, time_ns=S))
    watched.model.feed([steering(counter=1, time_ns=S + 10 * MS + hour_ns)], OFFSET_NS - hour_ns)
    row = watched.row()
    assert row.newest_ns == OFFSET_NS + S + 10 * MS
    assert row.gap_ns_max == 10 * MS


def test_the_order_of_ids_is_strict() -> None:
    watched = Watched()
    watched.feed(heard("001#"), heard("00000001#"), heard("001#R"))
    ids = [(row.word & 0x1FFF_FFFF, row.word) for row in
           watched.view.rows(watched.model, watched.now_ns)]  # fmt: skip
    assert all(a < b for a, b in pairwise(ids))

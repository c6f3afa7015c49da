"""`dbw plot`: two files, and mistakes in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from canbus.candump import log_line
from canbus.heard import Heard
from dbw.main import main
from tests.scenarios.driving import ready

Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A car that goes to READY; its bus as candump writes it."""
    drive = ready()
    rows = drive.world.trace.rows
    path = tmp_path_factory.mktemp("plot") / "drive.log"
    path.write_text("".join(
        log_line(Heard(time_ns, "can0", frame.can_id, frame.data, len(frame.data))) + "\n"
        for time_ns, _, frame in rows
    ))  # fmt: skip
    return path


def test_a_picture_and_a_page_are_written(log: Path, tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "out"
    assert main([
        "plot", str(log), "-s", "SteerStatus.steering_wheel_angle_rad",
        "-s", "SUPERVISOR_STATE.mode", "--from", "0.5", "--out", str(out),
    ]) == 0  # fmt: skip
    assert capsys.readouterr().out == f"written to {out}/: plot.html, plot.png\n"
    page = (out / "plot.html").read_text(encoding="utf-8")
    assert "STEER_STATUS.steering_wheel_angle_rad" in page and "READY" in page
    assert (out / "plot.png").stat().st_size > 20_000


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ([], "-s is missing"),
        (["-s", "SteerStatus"], "--signal SteerStatus: MESSAGE.SIGNAL is wanted"),
        (["-s", "SteerStatus.angle"], "STEER_STATUS has no signal 'angle'"),
        (["-s", "SterStatus.angle"], "did you mean STEER_STATUS"),
        (["-s", "GATEWAY_SDO_RESPONSE.payload", "--to", "-1"], "has no frame of"),
        (["-s", "SteerStatus.steering_wheel_angle_rad", "--from", "900"], "has no frame of"),
    ],
)
def test_what_cannot_be_drawn_is_told_in_one_line(
    log: Path, tmp_path: Path, capsys: Capture, options: list[str], reason: str
) -> None:
    out = tmp_path / "out"
    assert main(["plot", str(log), *options, "--out", str(out)]) == 2
    shown = capsys.readouterr()
    assert reason in shown.err and shown.err.count("\n") == 1
    assert not out.exists()


def test_a_message_that_never_came_is_told_beside_what_did(
    log: Path, tmp_path: Path, capsys: Capture
) -> None:
    assert main([
        "plot", str(log), "-s", "SteerStatus.steering_wheel_angle_rad",
        "-s", "ThrottleEmergencyBrake.reason", "--out", str(tmp_path / "out"),
    ]) == 0  # fmt: skip
    assert "no frame of THROTTLE_EMERGENCY_BRAKE" in capsys.readouterr().err

"""`AsyncCar` in virtual time."""

from __future__ import annotations

import asyncio
import math

import pytest

from dbc.messages import Inhibit, Mode, Request
from gateway.api import AsyncCar
from gateway.errors import EngageRefused, LinkFailed, NotConnected
from tests.gateway.scripted import Rig, RigLink, named, obedient_supervisor


def make() -> tuple[AsyncCar, RigLink, Rig]:
    rig = Rig()
    rig.react = obedient_supervisor
    link = RigLink(rig)
    return AsyncCar(link), link, rig


def test_async_planner_drives_the_car() -> None:
    async def drive() -> None:
        car, link, rig = make()
        async with car:
            await car.engage()
            ticks = 0
            async for state in car.ticks():
                assert state.is_engaged
                car.command(speed_mps=2.0, curvature_per_m=-0.02)
                ticks += 1
                if ticks == 20:
                    break
            link.on_cycle = lambda: rig.mode(Mode.READY)
            await car.disengage()
            assert car.state.mode is Mode.READY
        assert link.calls == ["open", "close"]
        with pytest.raises(NotConnected):
            await car.engage()

    asyncio.run(drive())


def test_other_tasks_command_the_curvature_during_the_controlled_stop() -> None:
    async def drive() -> None:
        car, link, rig = make()
        async with car:
            await car.engage()

            async def steer() -> None:
                async for _ in car.ticks():
                    car.command(speed_mps=0.0, curvature_per_m=0.05)

            steering = asyncio.create_task(steer())
            end_ns = rig.now_ns + 500_000_000
            link.on_cycle = lambda: rig.mode(Mode.READY) if rig.now_ns > end_ns else None
            rig.sent.clear()
            await car.disengage()
            ages = [c.content.decision_age_ms for c in named(rig.sent, "STEER_COMMAND")]
            assert len(ages) > 20
            assert max(age for age in ages if not math.isnan(age)) <= 40
            await car.close()
            await steering  # its ticks end with the car

    asyncio.run(drive())


def test_cancelled_engagement_is_withdrawn() -> None:
    async def drive() -> None:
        car, _, rig = make()
        rig.react = lambda rig, sent: None
        async with car:
            engaging = asyncio.create_task(car.engage())
            for _ in range(5):
                await asyncio.sleep(0)
            assert rig.state().pending_request is Request.ENGAGE
            engaging.cancel()
            with pytest.raises(asyncio.CancelledError):
                await engaging
            assert rig.state().pending_request is Request.NONE

    asyncio.run(drive())


def test_async_refusal_says_why_and_reset_works() -> None:
    async def drive() -> None:
        car, _, rig = make()
        async with car:
            rig.mode(Mode.EMERGENCY, inhibit=Inhibit.CODE_LATCHED, er5=True)
            with pytest.raises(EngageRefused, match=r"error code is latched.*\(ER5\)"):
                await car.engage(timeout_s=0.2)
            await car.reset()
            assert car.state.mode is Mode.MANUAL

    asyncio.run(drive())


def test_leaving_the_async_block_while_automatic_is_a_controlled_stop() -> None:
    async def drive() -> None:
        car, link, rig = make()
        async with car:
            await car.engage()
            link.on_cycle = lambda: rig.mode(Mode.READY)
        requests = [item.content.request for item in named(rig.sent, "MODE_REQUEST")]
        assert requests[-1] is Request.DISENGAGE
        assert link.calls == ["open", "close"]

    asyncio.run(drive())


def test_async_broken_link_surfaces_unless_another_error_is_under_way() -> None:
    async def drive(error: Exception | None) -> RigLink:
        car, link, _ = make()
        with pytest.raises(LinkFailed if error is None else type(error)):
            async with car:
                link.failure = LinkFailed("bus gone")
                if error is not None:
                    raise error
        return link

    for error in (None, ZeroDivisionError()):
        assert asyncio.run(drive(error)).calls == ["open", "close"]

"""Between the bus and the browsers: who is connected, what each is sent, what each may do.

Sans-I/O: the server below it opens sockets and keeps time, whoever owns the controls moves the
car. All browsers are sent the same changes at the same time. One that does not take them in time
is left out, and gets everything anew once it does, so that nothing piles up for it.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

from telemetry.dashboard.access import Access
from telemetry.dashboard.control import NO_WISH, Action, Controls, DeadMan, Refused
from telemetry.dashboard.picture import PLOTTABLE, Picture, Values

NS_PER_S: Final = 1_000_000_000
CLIENTS_MAX: Final = 16
PLOTS_MAX: Final = 8
WRONG_TOKENS_MAX: Final = 5
"""A connection that has shown so many wrong tokens is shown the door."""

_LOGGED: Final = {
    Action.EMERGENCY_BRAKE: "emergency brake",
    Action.BUTTON: "Auto/Manual button",
    Action.ENGAGE: "engage",
    Action.DISENGAGE: "disengage",
    Action.RESET: "reset",
}


@dataclass(slots=True, eq=False)
class Client:
    """One browser.

    Attributes:
        send: Hands it a text.
        is_busy: Whether it has not yet taken what was sent last.
        close: Ends the connection.
        may_control: Whether it has shown the token.
        has_all: Whether changes are enough for it.
        plots: Signals that it plots.
    """

    send: Callable[[str], None]
    is_busy: Callable[[], bool]
    close: Callable[[], None]
    may_control: bool = False
    has_all: bool = False
    wrong_tokens: int = 0
    plots: list[str] = field(default_factory=list)


class Hub:
    """All browsers on one bus.

    Args:
        picture: Of the bus.
        access: Knows the token.
        controls: What can be done here.
        start: Runs an action that may take seconds, beside all else; calls the second argument
            with the reason if it was refused, else with an empty text.
        about: What a page is told once: names, and what the dashboard stands beside.
    """

    def __init__(
        self,
        picture: Picture,
        access: Access,
        controls: Controls,
        start: Callable[[Callable[[], None], Callable[[str], None]], None],
        about: Values,
    ) -> None:
        self._picture = picture
        self._access = access
        self._controls = controls
        self._start = start
        self._about = about
        self._dead_man = DeadMan()
        self._now_ns = 0
        self.clients: list[Client] = []

    # Browsers come and go ---------------------------------------------------------------------

    def open(self, client: Client) -> bool:
        """A browser has connected; whether there is room for it."""
        if len(self.clients) >= CLIENTS_MAX:
            return False
        self.clients.append(client)
        limits = self._controls.limits
        hello = {
            **self._about,
            "actions": sorted(self._controls.actions),
            "limits": {name: getattr(limits, name) for name in limits.__slots__},
            "signals": PLOTTABLE,
        }
        client.send(json.dumps({"hello": hello}))
        return True

    def close(self, client: Client) -> None:
        """It is gone: what it held is let go."""
        if client in self.clients:
            self.clients.remove(client)
        self._let_go(client)

    def take(self, client: Client, text: str | bytes, now_ns: int) -> None:
        """A message from a browser. What is no message of ours is answered with a complaint."""
        self._now_ns = now_ns
        try:
            self._obey(client, _parsed(text), now_ns)
        except Refused as refusal:
            client.send(json.dumps({"refused": str(refusal)}))

    def _obey(self, client: Client, message: dict[str, Any], now_ns: int) -> None:
        match message.get("do"):
            case "show_token":
                self._show_token(client, message.get("token"))
            case "plot":
                client.plots = _plots(message.get("signals"))
            case "release":
                self._let_go(client)
            case str(name) if name in Action.__members__.values():
                self._act(client, Action(name), message, now_ns)
            case _:
                raise Refused("not understood")

    def _show_token(self, client: Client, token: object) -> None:
        client.may_control = self._access.is_token(token)
        client.send(json.dumps({"control": client.may_control}))
        if not client.may_control:
            client.wrong_tokens += 1
            self._let_go(client)
            if client.wrong_tokens >= WRONG_TOKENS_MAX:
                client.close()

    # What they ask for ------------------------------------------------------------------------

    def _act(
        self, client: Client, action: Action, message: dict[str, Any], now_ns: int
    ) -> None:
        if not client.may_control:
            raise Refused("this needs the token: open the address that the dashboard printed")
        controls = self._controls
        if action not in controls.actions:
            raise Refused(f"{action.value}: not possible from this dashboard")
        if action is Action.HOLD:
            self._dead_man.hold(client, controls.limits.wish(message), now_ns)
            controls.hold(self._dead_man.wish)
            return
        self._picture.say(now_ns, "page", f"{_LOGGED[action]} asked for")
        if action is Action.EMERGENCY_BRAKE:
            controls.emergency_brake()
            return
        self._start(lambda: controls.act(action), lambda why: self._answer(client, action, why))

    def _answer(self, client: Client, action: Action, why: str) -> None:
        """An action is over."""
        if why:
            self._picture.say(self._now_ns, "page", f"{_LOGGED[action]} refused: {why}")
            if client in self.clients:
                client.send(json.dumps({"refused": why}))

    def _let_go(self, client: Client) -> None:
        was_held = self._dead_man.is_held()
        self._dead_man.release(client)
        if was_held and not self._dead_man.is_held():
            self._let_car_go()

    def _let_car_go(self) -> None:
        """Whatever comes of it: nobody waits for an answer."""
        try:
            self._controls.hold(NO_WISH)
        except Refused as refusal:
            self._picture.say(self._now_ns, "page", f"not let go: {refusal}")

    # What they are sent -----------------------------------------------------------------------

    def step(self, now_ns: int) -> None:
        """Sends what has changed; a fixed number of times a second."""
        self._now_ns = now_ns
        if self._dead_man.elapse(now_ns):
            self._let_car_go()
            self._picture.say(now_ns, "page", "the browser fell silent: what it held is let go")
        changes = self._picture.step(now_ns)
        time_s = round(now_ns / NS_PER_S, 3)
        for client in list(self.clients):
            if client.is_busy():
                client.has_all = False
                continue
            news = changes if client.has_all else self._picture.whole()
            message = {"t": time_s, "news": news}
            if not client.has_all:
                message["anew"] = True
                client.has_all = True
            if client.plots:
                message["plots"] = self._picture.plotted(client.plots, now_ns)
            client.send(json.dumps(message, separators=(",", ":")))


def _parsed(text: str | bytes) -> dict[str, Any]:
    try:
        message = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise Refused("not understood") from error
    if not isinstance(message, dict):
        raise Refused("not understood")
    return message


def _plots(names: object) -> list[str]:
    if not isinstance(names, list) or len(names) > PLOTS_MAX:
        raise Refused(f"plots: a list of at most {PLOTS_MAX} signals is wanted")
    unknown = [name for name in names if not isinstance(name, str) or name not in PLOTTABLE]
    if unknown:
        raise Refused(f"no signal {str(unknown[0])[:80]!r}")
    return names

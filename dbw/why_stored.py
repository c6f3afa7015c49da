"""`dbw why --stored`: the freeze frames on disk."""

from __future__ import annotations

import json
from typing import Any

import click
import numpy as np

from dbw.failures import EXIT_OK, complain
from telemetry.why.freeze import FreezeError, FreezeStore, read_document

MS_PER_S = 1000


def list_stored(store: FreezeStore, *, as_json: bool) -> int:
    """One line each, oldest first; files that cannot be read are complained of."""
    rows = []
    for item in store.entries():
        try:
            document = read_document(item.path)
        except FreezeError as error:
            complain(error)
            continue
        keys = ("code", "node", "reason", "unix_s", "channel")
        rows.append({"number": item.number, **{key: document[key] for key in keys}})
    if as_json:
        click.echo(json.dumps(rows, indent=1))
        return EXIT_OK
    for row in rows:
        click.echo(
            f"{row['number']:6d}  {_utc(row['unix_s'])}  {row['channel']:<8} {row['code']}  "
            f"{row['node']}: {row['reason']}"
        )
    if not rows:
        click.echo(f"no freeze frame in {store.folder}")
    return EXIT_OK


def print_stored(store: FreezeStore, number: int, *, as_json: bool) -> int:
    """All of one: a line for each change of a signal.

    Raises:
        FreezeError: There is none of this number, or it cannot be read.
    """
    document = store.load(number)
    if as_json:
        click.echo(json.dumps(document))
        return EXIT_OK
    click.echo(
        f"freeze frame {number}: {document['code']} from {document['node']} "
        f"({document['reason']}) at {_utc(document['unix_s'])} on {document['channel']}"
    )
    count = len(document["frames"])
    left_out = document.get("frames_left_out", 0)
    more = f", {left_out} more left out" if left_out else ""
    click.echo(f"{count} frames{more}; at each time what changed, in s from the code on")
    for at_s, message, changed in changes(document["signals"]):
        values = " ".join(f"{name}={value}" for name, value in changed.items())
        click.echo(f"{at_s:+10.6f}  {message:<30} {values}")
    return EXIT_OK


def changes(signals: dict[str, dict[str, list[Any]]]) -> list[tuple[float, str, dict[str, Any]]]:
    """`(at_s, message, signals)` for each frame that tells something new, in order of time."""
    found = []
    for message, table in signals.items():
        last: dict[str, Any] = {}
        for index, at_s in enumerate(table["at_s"]):
            now = {name: column[index] for name, column in table.items() if name != "at_s"}
            changed = {name: value for name, value in now.items() if last.get(name, now) != value}
            last = now
            if changed:
                found.append((at_s, message, changed))
    return sorted(found, key=lambda item: item[0])


def _utc(unix_s: float) -> str:
    return f"{np.datetime64(round(unix_s * MS_PER_S), 'ms')}Z"

"""The JSON schema of a message: what a live viewer and a recording tell of its values.

Values are under the names of the signals; `mode_name` beside `mode` is the name of a value, and
`verdict` a receiver's judgement of counter and CRC. What the sender does not have is left out.
"""

from __future__ import annotations

from typing import Any, Final

from telemetry.databases import Message, Signal
from telemetry.decode.export import NAME_SUFFIX
from telemetry.decode.tables import VERDICTS

VERDICT: Final = "verdict"


def schema_of(message: Message, *, has_verdict: bool) -> dict[str, Any]:
    """The schema of a message; `has_verdict` if its counter and CRC are judged."""
    properties: dict[str, Any] = {}
    if has_verdict:
        properties[VERDICT] = {"type": "string", "enum": list(VERDICTS)}
    for signal in message.signals:
        properties[signal.name] = _property(signal)
        if signal.choices:
            names = [str(text) for text in signal.choices.values()]
            properties[f"{signal.name}{NAME_SUFFIX}"] = {"type": "string", "enum": names}
    schema = {"title": message.name, "type": "object", "properties": properties}
    return schema | ({"description": message.comment} if message.comment else {})


def _property(signal: Signal) -> dict[str, str]:
    is_whole = not signal.is_float and all(
        float(number).is_integer() for number in (signal.scale, signal.offset)
    )
    text = "; ".join(part for part in (signal.unit, signal.comment) if part)
    kind = {"type": "integer" if is_whole else "number"}
    return kind | ({"description": text} if text else {})

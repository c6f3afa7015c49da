"""Tables as files and data frames: CSV, Parquet, pandas."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from telemetry.databases import load_databases
from telemetry.decode.tables import Decoded, Decoder, Names, Table
from telemetry.logs.reading import Log

if TYPE_CHECKING:
    import pandas

NS_PER_S = 1_000_000_000
NAME_SUFFIX = "_name"
"""Of the column beside a signal's numbers that holds their names."""


def columns_of(table: Table) -> dict[str, NDArray[Any] | Names]:
    """All columns of a table by name, in order: time, channel, protection, signals, names."""
    frames = table.frames
    channels = Names(places=frames.channel.astype(np.uint16), texts=tuple(frames.channels))
    columns: dict[str, NDArray[Any] | Names] = {"time_ns": frames.time_ns, "channel": channels}
    if table.protection is not None:
        columns["verdict"] = table.protection.verdict
    for name, values in table.values.items():
        columns[name] = values
        if name in table.names:
            columns[f"{name}{NAME_SUFFIX}"] = table.names[name]
    return columns


def decode_log(
    path: str | Path, dbc: list[str | Path] | None = None, *, relaxed: bool = False
) -> dict[str, pandas.DataFrame]:
    """A log as data frames, one for each message that is in it: for notebooks.

    The index is the time in seconds (`time_s`). Values are not interpolated: a row is a frame. A
    signal whose values have names has a second, categorical column, `mode_name` beside `mode`; NaN
    is a value that the sender did not have. Protected messages of the project's bus have a column
    `verdict`.

    Args:
        path: Log of candump, ASC, BLF, TRC, MCAP or MF4.
        dbc: Files as for `telemetry.databases.load_databases`; None: the project's vehicle bus.
        relaxed: Load what can be read of a DBC with errors.

    Raises:
        LogError: The log cannot be read.
        DatabaseError: A DBC cannot be read.
    """
    databases = load_databases(dbc or (), relaxed=relaxed)
    decoded = Decoder(databases).decode(Log(path).columns())
    return {name: data_frame(table) for name, table in decoded.tables.items()}


def data_frame(table: Table) -> pandas.DataFrame:
    """One table as a data frame, with the time in seconds as its index."""
    import pandas

    columns = columns_of(table)
    del columns["time_ns"]
    series = {
        name: _categorical(column) if isinstance(column, Names) else column
        for name, column in columns.items()
    }
    time_s = pandas.Index(table.frames.time_ns / NS_PER_S, name="time_s")
    return pandas.DataFrame(series, index=time_s, copy=False)


def _categorical(names: Names) -> pandas.Categorical:
    import pandas

    if len(set(names.texts)) < len(names.texts):  # a DBC may give two numbers one name
        return pandas.Categorical(names.all)
    return pandas.Categorical.from_codes(names.places, categories=list(names.texts))


def write_csv(decoded: Decoded, folder: Path) -> list[Path]:
    """A CSV file for each message; answers their paths."""
    from pyarrow.csv import write_csv as write

    return _write_each(decoded, folder, "csv", write)


def write_parquet(decoded: Decoded, folder: Path) -> list[Path]:
    """A Parquet file for each message; answers their paths."""
    from pyarrow.parquet import write_table as write

    return _write_each(decoded, folder, "parquet", write)


def _write_each(
    decoded: Decoded, folder: Path, ending: str, write: Callable[[Any, str], object]
) -> list[Path]:
    paths = []
    for name, table in sorted(decoded.tables.items()):
        paths.append(folder / f"{name}.{ending}")
        write(_arrow(table), str(paths[-1]))
    return paths


def _arrow(table: Table) -> Any:
    import pyarrow

    units = {signal.name: signal.unit or "" for signal in table.message.signals}
    arrays, fields = [], []
    for name, values in columns_of(table).items():
        if isinstance(values, Names):
            array = pyarrow.array(values.texts).take(pyarrow.array(values.places))
        else:
            array = pyarrow.array(values, from_pandas=values.dtype.kind == "f")
        arrays.append(array)
        unit = units.get(name, "ns" if name == "time_ns" else "")
        fields.append(pyarrow.field(name, array.type, metadata={"unit": unit}))
    return pyarrow.Table.from_arrays(arrays, schema=pyarrow.schema(fields))

"""Results as Parquet: three datasets of small part files, each written in one step.

`seeds/`, `injections/` and `violations/` hold files of the same names, by first and last seed. A
part counts when its file in `seeds/` is there, which is written last.
"""

from __future__ import annotations

import heapq
import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import pyarrow as pa
import pyarrow.parquet as pq

from campaign.result import Demand, InjectionResult, SeedResult, ViolationResult

SEEDS, INJECTIONS, VIOLATIONS = "seeds", "injections", "violations"
DATASETS = (INJECTIONS, VIOLATIONS, SEEDS)
"""In the order in which they are written."""
NESTED = {INJECTIONS: InjectionResult, VIOLATIONS: ViolationResult}
"""Fields of a seed that are datasets of their own, each row with its `seed`."""
UNFINISHED = ".unfinished-"

COLUMN_OF: dict[Any, Any] = {
    int: pa.int64(),
    float: pa.float64(),
    float | None: pa.float64(),
    bool: pa.bool_(),
    str: pa.string(),
    Demand: pa.string(),
    tuple[float, ...]: pa.list_(pa.float64()),
}

Row = dict[str, Any]
ItemT = TypeVar("ItemT")


def _schema(kind: type) -> Any:
    """Columns of a dataclass."""
    hints = get_type_hints(kind).items()
    columns = [(name, COLUMN_OF[hint]) for name, hint in hints if name not in NESTED]
    return pa.schema(columns if kind is SeedResult else [("seed", pa.int64()), *columns])


SCHEMAS = {
    SEEDS: _schema(SeedResult),
    **{name: _schema(kind) for name, kind in NESTED.items()},
}


def write_part(folder: Path, results: Iterable[SeedResult]) -> None:
    """Writes some results as one part of each dataset.

    Raises:
        OSError: A file cannot be written.
    """
    rows: dict[str, list[Row]] = {name: [] for name in DATASETS}
    for result in sorted(results, key=lambda result: result.seed):
        row = asdict(result)
        for name in NESTED:
            rows[name] += [{"seed": result.seed, **nested} for nested in row.pop(name)]
        rows[SEEDS].append(row)
    first, last = rows[SEEDS][0]["seed"], rows[SEEDS][-1]["seed"]
    for name in DATASETS:
        table = pa.Table.from_pylist(rows[name], schema=SCHEMAS[name])
        _write(folder / name / f"{first:019d}-{last:019d}.parquet", table)


def _write(path: Path, table: Any) -> None:
    """All of the file or none, whatever happens meanwhile."""
    unfinished = path.with_name(UNFINISHED + path.name)
    with unfinished.open("wb") as file:
        pq.write_table(table, file, compression="zstd")
        file.flush()
        os.fsync(file.fileno())
    unfinished.replace(path)


def part_names(folder: Path) -> list[str]:
    """File names of all parts that count, by first seed."""
    return sorted(path.name for path in (folder / SEEDS).glob("[0-9]*.parquet"))


def remove_leftovers(folder: Path) -> None:
    """Removes what an interrupted writer left behind."""
    names = set(part_names(folder))
    for dataset in DATASETS:
        for path in (folder / dataset).iterdir():
            if path.name.startswith(UNFINISHED) or path.name not in names:
                path.unlink()


def _first_seed(name: str) -> int:
    return int(name.partition("-")[0])


def _rows(folder: Path, dataset: str, name: str, columns: Sequence[str] | None = None) -> list[Row]:
    """Rows of one file, in order of seed."""
    with pq.ParquetFile(folder / dataset / name) as file:
        rows: list[Row] = file.read(columns, use_threads=False).to_pylist()
    return rows


def _part(folder: Path, name: str) -> Iterator[SeedResult]:
    injections: dict[int, list[InjectionResult]] = defaultdict(list)
    for row in _rows(folder, INJECTIONS, name):
        seed, demand = row.pop("seed"), Demand(row.pop("demand"))
        injections[seed].append(InjectionResult(demand=demand, **row))
    violations: dict[int, list[ViolationResult]] = defaultdict(list)
    for row in _rows(folder, VIOLATIONS, name):
        violations[row.pop("seed")].append(ViolationResult(**row))
    for row in _rows(folder, SEEDS, name):
        seed, repairs_s = row["seed"], tuple(row.pop("repairs_s"))
        yield SeedResult(
            **row,
            repairs_s=repairs_s,
            injections=tuple(injections[seed]),
            violations=tuple(violations[seed]),
        )


def read_results(folder: Path) -> Iterator[SeedResult]:
    """All results, in order of seed."""
    for _, result in _in_order(folder, lambda name: ((r.seed, r) for r in _part(folder, name))):
        yield result


def read_hashes(folder: Path) -> Iterator[tuple[int, str]]:
    """`(seed, trace_sha256)` of all results, in order of seed."""
    columns = ("seed", "trace_sha256")

    def hashes(name: str) -> Iterator[tuple[int, str]]:
        for row in _rows(folder, SEEDS, name, columns):
            yield row["seed"], row["trace_sha256"]

    return _in_order(folder, hashes)


def _in_order(
    folder: Path, read: Callable[[str], Iterable[tuple[int, ItemT]]]
) -> Iterator[tuple[int, ItemT]]:
    """Items of all parts by seed. Only parts that overlap are in memory at a time."""
    waiting: list[tuple[int, ItemT]] = []
    for name in part_names(folder):
        while waiting and waiting[0][0] < _first_seed(name):
            yield heapq.heappop(waiting)
        for item in read(name):
            heapq.heappush(waiting, item)
    while waiting:
        yield heapq.heappop(waiting)


def read_result(folder: Path, seed: int) -> SeedResult | None:
    """The result of one seed; None if it is not there."""
    for name in part_names(folder):
        last = int(name.removesuffix(".parquet").partition("-")[2])
        if _first_seed(name) <= seed <= last:
            found = [result for result in _part(folder, name) if result.seed == seed]
            if found:
                return found[0]
    return None

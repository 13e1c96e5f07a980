"""Results as columns: for the page in memory, for others as Parquet (extra `campaign`) or CSV; JUnit XML.

Belongs here: one pass over the rows of a campaign. Not: what is drawn of them (page).
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as Tree
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emulator.campaigns.campaign import Campaign
from emulator.campaigns.factors import Floats
from emulator.campaigns.store import BROKEN, Row, Store
from emulator.errors import EmulatorError
from emulator.output.csv_tables import Writer
from emulator.output.sanitizing import visible

VERDICTS = ("passed", "failed", "error", "crashed", "hung")
CODES = {name: code for code, name in enumerate(VERDICTS)}
CHUNK = 20_000
MOST_CASES_JUNIT = 20_000
"Test cases of the JUnit report; of more, those that did not pass come first."
MOST_REPORTED = 5_000
"Reasons kept for the page and JUnit."


@dataclass
class Results:
    """One entry a case, in the order of the design."""

    names: NDArray[np.bytes_]
    number: NDArray[np.int64]
    repeat: NDArray[np.int32]
    verdict: NDArray[np.int8]
    seconds: Floats
    factors: dict[str, Floats]
    "Values of numeric columns, numbers of the levels of others."
    levels: dict[str, list[str]]
    "Texts of the levels of columns that are not numeric."
    quantities: dict[str, Floats]
    recorded: NDArray[np.bool_]
    expect: dict[str, Counter[bool]]
    reported: dict[str, str] = field(default_factory=dict)
    "Why cases did not pass, as far as kept."
    log: frozenset[str] = frozenset()
    "Factors that are spread over decades."

    def __len__(self) -> int:
        return len(self.names)

    def counts(self) -> dict[str, int]:
        """Cases by verdict."""
        return {name: int(np.sum(self.verdict == at)) for at, name in enumerate(VERDICTS)}

    @property
    def passed(self) -> Floats:
        """1 passed, 0 failed, NaN did not come to its end."""
        return np.where(self.verdict == 0, 1.0, np.where(self.verdict == 1, 0.0, np.nan))

    def value(self, name: str) -> Floats:
        """A quantity, or `pass`."""
        return self.passed if name == "pass" else self.quantities[name]


def gather(campaign: Campaign, rows: Iterable[Row], out: Path) -> tuple[Results, Path]:
    """All rows as columns, and written as a table beside them; the table's path."""
    columns = [column for one in campaign.factors for column in one.columns]
    numeric = {column for one in campaign.factors if one.numeric for column in one.columns}
    expect: dict[str, Counter[bool]] = {name: Counter() for name in campaign.expect}
    codes: dict[str, dict[str, int]] = {column: {} for column in columns if column not in numeric}
    reported: dict[str, str] = {}
    writer = _writer(campaign, columns, numeric, out)
    quantities = list(campaign.file.quantities)
    parts: list[list[NDArray[Any]]] = [[] for _ in range(6 + len(columns) + len(quantities))]
    for batch in _batches(rows):
        table = _columns(batch, columns, numeric, quantities, campaign.expect)
        writer.add(table)
        for row in batch:
            if row["expect"]:
                for name, held in row["expect"].items():
                    expect.setdefault(name, Counter())[held] += 1
            if row["fault"] and len(reported) < MOST_REPORTED:
                reported[row["name"]] = row["fault"]
        made = [
            np.array(table["case"], dtype="S64"),
            np.array(table["number"], dtype=np.int64),
            np.array(table["repeat"], dtype=np.int32),
            np.array([CODES[one] for one in table["verdict"]], dtype=np.int8),
            _numbers(table["seconds"]),
            np.array(table["recording_bytes"]) > 0,
            *(_coded(table[one], codes.get(one)) for one in columns),
            *(_numbers(table[f"quantity: {one}"]) for one in quantities),
        ]
        for part, column in zip(parts, made, strict=True):
            part.append(column)
    path = writer.close()
    kinds: list[Any] = ["S64", np.int64, np.int32, np.int8, np.float64, bool]
    kinds += [np.float64] * (len(parts) - len(kinds))

    def joined(at: int) -> NDArray[Any]:
        return np.concatenate(parts[at]) if parts[at] else np.zeros(0, kinds[at])

    order = np.lexsort((joined(2), joined(1)))
    whole: list[Any] = []
    for at, part in enumerate(parts):  # one after the other: of a million cases each takes its room
        whole.append(joined(at)[order])
        part.clear()
    factors = dict(zip(columns, whole[6 : 6 + len(columns)], strict=True))
    found = dict(zip(quantities, whole[6 + len(columns) :], strict=True))
    levels = {column: list(known) for column, known in codes.items()}
    log = frozenset(one.name for one in campaign.factors if one.log)
    names, number, repeat, verdict, seconds, recorded = whole[:6]
    return Results(
        names, number, repeat, verdict, seconds, factors, levels, found, recorded, expect, reported, log
    ), path


def gather_counts(store: Store, wanted: set[str] | None) -> dict[str, int]:
    """Done cases by verdict; `wanted`: of these alone."""
    counts: Counter[str] = Counter()
    for row in store.rows(store.names() if wanted is None else wanted):
        counts[row["verdict"]] += 1
    return {one: counts[one] for one in VERDICTS}


def _batches(rows: Iterable[Row]) -> Iterator[list[Row]]:
    batch: list[Row] = []
    for row in rows:
        batch.append(row)
        if len(batch) == CHUNK:
            yield batch
            batch = []
    if batch:
        yield batch


def _numbers(values: Sequence[Any]) -> Floats:
    """As floating point; what is no number is NaN."""
    try:
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        return np.array([float(one) if isinstance(one, int | float) else float("nan") for one in values])


def _coded(values: Sequence[Any], codes: dict[str, int] | None) -> Floats:
    """Numbers as they are, texts as the numbers of their levels."""
    if codes is None:
        return _numbers(values)
    return np.array([float(codes.setdefault(text, len(codes))) for text in values])


def _columns(
    rows: Sequence[Row], columns: Sequence[str], numeric: set[str], quantities: Sequence[str], expect: Sequence[str]
) -> dict[str, list[Any]]:
    """Rows as the columns of the table, by head."""
    table: dict[str, list[Any]] = {"case": [row["name"] for row in rows]}
    for one in ("number", "repeat", "seed"):
        table[one] = [row[one] for row in rows]
    factors = [row["factors"] for row in rows]
    for one in columns:
        values = [values.get(one) for values in factors]
        texts = one not in numeric
        table[one] = [one if isinstance(one, str) else json.dumps(one) for one in values] if texts else values
    table["verdict"] = [row["verdict"] for row in rows]
    held = [row["expect"] for row in rows]
    for one in expect:
        table[f"expect: {one}"] = [values.get(one) for values in held]
    found = [row["quantities"] for row in rows]
    for one in quantities:
        table[f"quantity: {one}"] = [values.get(one) for values in found]
    for one in ("seconds", "sha256", "fault", "recording_bytes"):
        table[one] = [row[one] for row in rows]
    return table


# ---------------------------------------------------------------- files


def _into_place(file: Any, aside: Path, path: Path) -> Path:
    try:
        file.close()
        aside.replace(path)
    except OSError as error:
        raise EmulatorError(f"{path}: cannot be written: {error}") from None
    return path


class _Csv:
    """Written as rows come, then renamed."""

    def __init__(self, path: Path, heads: Sequence[str]) -> None:
        self._path, self._aside = path, Store(path.parent).aside(path.name)
        try:
            self._file = self._aside.open("w", newline="", encoding="utf-8")
        except OSError as error:
            raise EmulatorError(f"{path}: cannot be written: {error.strerror}") from None
        self._writer = Writer(self._file, {head: ".12g" for head in heads})

    def add(self, table: dict[str, list[Any]]) -> None:
        try:
            self._writer.rows(zip(*table.values(), strict=True))
        except OSError as error:
            raise EmulatorError(f"{self._path}: cannot be written: {error}") from None

    def close(self) -> Path:
        return _into_place(self._file, self._aside, self._path)


class _Parquet:
    """A row group a batch, then renamed."""

    def __init__(self, path: Path, heads: Sequence[str], kinds: Sequence[str]) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        kind_of = {"f": pa.float64(), "i": pa.int64(), "b": pa.bool_(), "s": pa.string()}
        self._pa = pa
        self._schema = pa.schema([(head, kind_of[kind]) for head, kind in zip(heads, kinds, strict=True)])
        self._path, self._aside, self._kinds = path, Store(path.parent).aside(path.name), kinds
        try:
            self._file = pq.ParquetWriter(self._aside, self._schema)
        except OSError as error:
            raise EmulatorError(f"{path}: cannot be written: {error}") from None

    def add(self, table: dict[str, list[Any]]) -> None:
        made = [
            self._array(values, kind, field.type)
            for values, kind, field in zip(table.values(), self._kinds, self._schema, strict=True)
        ]
        try:
            self._file.write_table(self._pa.Table.from_arrays(made, schema=self._schema))
        except OSError as error:
            raise EmulatorError(f"{self._path}: cannot be written: {error}") from None

    def _array(self, values: list[Any], kind: str, type_: Any) -> Any:
        try:
            return self._pa.array(values, type_)
        except self._pa.ArrowInvalid:  # numbers of several types
            return self._pa.array([None if one is None else float(one) for one in values], type_)

    def close(self) -> Path:
        return _into_place(self._file, self._aside, self._path)


def _writer(campaign: Campaign, columns: Sequence[str], numeric: set[str], out: Path) -> _Csv | _Parquet:
    names, expect = list(campaign.file.quantities), campaign.expect
    heads = [
        "case", "number", "repeat", "seed", *columns, "verdict", *(f"expect: {one}" for one in expect),
        *(f"quantity: {one}" for one in names), "seconds", "sha256", "fault", "recording_bytes",
    ]  # fmt: skip
    kinds = ["s", "i", "i", "i", *("f" if one in numeric else "s" for one in columns), "s"]
    kinds += ["b"] * len(expect) + ["f"] * len(names) + ["f", "s", "s", "i"]

    try:
        import pyarrow  # noqa: F401
    except ImportError:
        return _Csv(out / "results.csv", heads)
    return _Parquet(out / "results.parquet", heads, kinds)


# ---------------------------------------------------------------- JUnit


def write_junit(campaign: Campaign, results: Results, missing: int, path: Path) -> None:
    """A test case for each case of the campaign; those not run are errors. Raises `EmulatorError`."""
    counts = results.counts()
    broken = sum(counts[one] for one in BROKEN)
    root = Tree.Element("testsuites", name="lidaremu")
    suite = Tree.SubElement(
        root, "testsuite", name=visible(str(campaign.path)), tests=str(len(results) + bool(missing)),
        failures=str(counts["failed"]), errors=str(broken + bool(missing)), skipped="0",
        time=f"{float(results.seconds.sum()):.3f}",
    )  # fmt: skip
    order = np.argsort(results.verdict == 0, kind="stable")[:MOST_CASES_JUNIT]
    if len(order) < len(results):
        properties = Tree.SubElement(suite, "properties")
        Tree.SubElement(properties, "property", name="cases left out", value=str(len(results) - len(order)))
    for at in order.tolist():
        name = results.names[at].decode()
        shown = ", ".join(f"{column}={shown_value(results, column, at)}" for column in results.factors)
        case = Tree.SubElement(
            suite, "testcase", classname=visible(campaign.path.stem), time=f"{results.seconds[at]:.3f}",
            name=visible(f"{shown or 'seed'} #{results.repeat[at]} {name[:12]}"),
        )  # fmt: skip
        verdict = VERDICTS[int(results.verdict[at])]
        if verdict != "passed":
            text = visible(results.reported.get(name, verdict), "\n")
            kind = "failure" if verdict == "failed" else "error"
            Tree.SubElement(case, kind, message=text.partition("\n")[0], type=verdict).text = text
    if missing:
        case = Tree.SubElement(suite, "testcase", classname=visible(campaign.path.stem), name="is complete", time="0")
        Tree.SubElement(case, "error", message=f"{missing} cases are not done")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        Tree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    except OSError as error:
        raise EmulatorError(f"{path}: cannot write: {error.strerror}") from None


def shown_value(results: Results, column: str, at: int) -> str:
    """A factor's value of one case, as text."""
    value = float(results.factors[column][at])
    known = results.levels.get(column)
    return known[int(value)] if known is not None else f"{value:.6g}"

"""The record of a run, as a Parquet file.

The first column is the time. Each further column is one element of a recorded signal.
`pandas.read_parquet(path)` loads a record as a data frame. The attribute `attrs["units"]` of the
data frame contains the units of the columns. The schema of the file also contains these units. If
the run was started from a scenario, the schema contains the provenance of the record under the key
freeflyer.origin (see `freeflyer.master.provenance`).
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import pyarrow.parquet as parquet

from freeflyer.fmi.component import Array
from freeflyer.foundation import bounded_file
from freeflyer.foundation.errors import CosimError, RecordError, UnknownSignal, one_line
from freeflyer.foundation.extras import needed_by
from freeflyer.foundation.output_file import write_whole
from freeflyer.foundation.suggestions import did_you_mean
from freeflyer.master import row_file
from freeflyer.master.provenance import KEY, Provenance

if TYPE_CHECKING:
    import pandas
    import xarray

MOST_NUMBERS = 1 << 30
"""Largest allowed number of values in a file that is read. This number of values needs 8 GiB."""


@dataclass(frozen=True, kw_only=True)
class Signal:
    """One recorded variable with the name COMPONENT.VARIABLE.

    The elements of the variable are in the columns `first` to `first + size - 1` of the record. The
    time is not counted as a column here. `units` contains the unit of each element, or None.
    """

    name: str
    first: int
    size: int
    units: tuple[str | None, ...]

    @property
    def columns(self) -> list[str]:
        return (
            [self.name] if self.size == 1 else [f"{self.name}[{i + 1}]" for i in range(self.size)]
        )


class Record:
    """A table of times and of the values of signals.

    The constructor allocates the memory for the largest number of rows, `rows`. With `file`, the
    memory is a file that has the rows also after the death of the process (`row_file`). Raises
    CosimError if there is not enough memory or disk space. The attribute `rows` is the number of
    rows that contain data.
    """

    def __init__(self, signals: Sequence[Signal], rows: int, file: Path | None = None) -> None:
        self.signals: Mapping[str, Signal] = {signal.name: signal for signal in signals}
        width = max((signal.first + signal.size for signal in signals), default=0)
        self.rows = 0
        self.provenance: Provenance | None = None
        if file is not None:
            described = [asdict(signal) for signal in signals]
            self._time, self._values = row_file.create(file, {"signals": described}, rows, width)
            return
        try:
            self._time = np.empty(rows)
            self._values = np.empty((rows, width))
        except MemoryError as error:
            size = rows * (width + 1) * 8 / 2**30
            raise CosimError(
                f"the record of {rows} rows with {width} columns needs {size:.3g} GiB, but less memory is available; increase "
                f"[record] every_s or reduce stop_s"
            ) from error

    def __repr__(self) -> str:
        span = f", {self.time[0]:g} to {self.time[-1]:g} s" if self.rows else ""
        return f"Record of {self.rows} rows{span}: {', '.join(self.signals)}"

    def append(self, time: float, values: Array) -> None:
        """Add a row: a time [s], and the values of all columns."""
        self._values[self.rows] = values
        self._time[self.rows] = time
        self.rows += 1

    @property
    def storage(self) -> tuple[Array, Array]:
        """The two allocated arrays. The first array contains the times.

        The second array contains the values, with one row for each time and one column for each
        element of a signal. In both arrays, only the first `rows` rows contain data.
        """
        return self._time, self._values

    @property
    def time(self) -> Array:
        """Times [s], shape (rows)."""
        return self._time[: self.rows]

    def __getitem__(self, name: str) -> Array:
        """Return the values of a signal. The shape is (rows, size), or (rows) for a scalar.

        NAME[k] is one element (rows), counted from 1. Raises UnknownSignal if the record does not
        contain the signal.
        """
        base, bracket, _ = str(name).partition("[")
        if bracket and base in self.signals and name in self.signals[base].columns:
            return self[base][:, self.signals[base].columns.index(name)]
        if name not in self.signals:
            raise UnknownSignal(
                f"the record has no signal {name!r}; `record.signals` lists its signals{did_you_mean(str(name), self.signals)}"
            )
        signal = self.signals[name]
        block = self._values[: self.rows, signal.first : signal.first + signal.size]
        return block[:, 0] if signal.size == 1 else block

    def __contains__(self, name: str) -> bool:
        return name in self.signals

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of the signals."""
        return iter(self.signals)

    @property
    def units(self) -> dict[str, str]:
        """Unit of every column. The unit of a column without a unit is ""."""
        named = {
            column: unit or ""
            for signal in self.signals.values()
            for column, unit in zip(signal.columns, signal.units, strict=True)
        }
        return {"time": "s", **named}

    @property
    def digest(self) -> str:
        """SHA-256 of the times, values, signals and provenance.

        Two records with the same digest have the same bits.
        """
        digest = hashlib.sha256()
        digest.update(json.dumps(self.units).encode())
        if self.provenance is not None:
            digest.update(self.provenance.to_json().encode())
        for array in (self.time, *(self[name] for name in self.signals)):
            digest.update(np.ascontiguousarray(array, dtype="<f8").data)
        return digest.hexdigest()

    @classmethod
    def from_rows(cls, path: Path) -> Record:
        """Read the rows of a run whose process has died, see `file` of the constructor.

        Raises RecordError if the file is damaged or cannot be read.
        """
        try:
            header, time, values = row_file.read(path)
            signals = [
                Signal(**{**signal, "units": tuple(signal["units"])})
                for signal in header["signals"]
            ]
            first = 0
            for signal in signals:
                texts = all(isinstance(text, str) for text in (signal.name, *(u or "" for u in signal.units)))  # fmt: skip
                if not texts or (signal.first, signal.size) != (first, len(signal.units)):
                    raise ValueError("its header does not describe the signals of a run")
                first += signal.size
            if values.shape[1] != first or values.size > MOST_NUMBERS:
                raise ValueError(f"it has {len(time)} rows of {values.shape[1]} numbers; {first} numbers, and at most {MOST_NUMBERS} in all, are expected")  # fmt: skip
            record = cls(signals, len(time))
            record._time[:], record._values[:] = time, values
        except (OSError, LookupError, TypeError, ValueError) as error:
            reason = getattr(error, "strerror", None) or one_line(error)
            if isinstance(error, LookupError | TypeError):
                reason = "its header does not describe the signals of a run"
            raise RecordError(f"{path} cannot be read as the rows of a run: {reason}") from error
        record.rows = len(time)
        return record

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Record:
        """Read a file that `write` has written. Nothing in the file is executed.

        Raises RecordError if the file cannot be read, or if it is not a record.
        """
        try:
            return cls._read(path)
        except (OSError, pa.ArrowException, ValueError, TypeError, LookupError) as error:
            reason = getattr(error, "strerror", None) or one_line(error)
            raise RecordError(
                f"{path} cannot be read as a record of `freeflyer run`: {reason}"
            ) from error

    @classmethod
    def _read(cls, path: str | os.PathLike[str]) -> Record:
        with bounded_file.opened(Path(path)) as opened, parquet.ParquetFile(opened) as file:
            rows, columns = file.metadata.num_rows, file.metadata.num_columns
            # Check the number of values before they are read: a small file can contain compressed
            # data that expand to any number of rows.
            if not 0 < columns * max(rows, 1) <= MOST_NUMBERS:
                raise ValueError(
                    f"it has {rows} rows of {columns} columns; at most {MOST_NUMBERS} numbers are expected"
                )
            table = file.read()
        # Combine the columns NAME[1], NAME[2], ... into one signal.
        elements: dict[str, list[str]] = {}
        for column in table.column_names[1:]:
            elements.setdefault(column.partition("[")[0], []).append(column)
        signals, first = [], 0
        for name, columns in elements.items():
            units = tuple(
                (table.field(column).metadata or {}).get(b"unit", b"").decode() or None
                for column in columns
            )
            signals.append(Signal(name=name, first=first, size=len(columns), units=units))
            first += len(columns)
        # Read the values, and the provenance from the schema.
        record = cls(signals, table.num_rows)
        record._time[:] = table.column(0).to_numpy()
        for place, column in enumerate(c for columns in elements.values() for c in columns):
            record._values[:, place] = table.column(column).to_numpy()
        record.rows = table.num_rows
        stored = (table.schema.metadata or {}).get(KEY)
        record.provenance = None if stored is None else Provenance.from_json(stored)
        return record

    def write(self, path: Path) -> None:
        """Write a Parquet file, completely or not at all.

        Raises OutputError if the file cannot be written.
        """
        write_whole(path, self.write_file)

    def write_file(self, path: Path) -> None:
        """Write a Parquet file. Raises OSError. An error leaves an incomplete file."""
        # Arrow accepts no path that is not valid UTF-8.
        with path.open("wb") as file:
            parquet.write_table(self.to_arrow(), file, compression="zstd")

    def to_pandas(self) -> pandas.DataFrame:
        """Return a data frame: the column `time` [s], and a column for each element of a signal.

        `attrs["units"]` has the units of the columns.
        """
        frame = self.to_arrow().to_pandas()
        frame.attrs["units"] = self.units
        return frame

    def to_xarray(self) -> xarray.Dataset:
        """Return a dataset with the dimension `time` [s]. Each signal is a variable.

        An array has a second dimension SIGNAL_element, counted from 1. `attrs["units"]` of a
        variable is the unit of its elements, or a list of units. Raises MissingExtra if the extra
        `analysis` is not installed.
        """
        with needed_by("Record.to_xarray"):
            import xarray

        variables = {}
        for name, signal in self.signals.items():
            axis = () if signal.size == 1 else (f"{name}_element",)
            units = [unit or "" for unit in signal.units]
            unit = units[0] if len(set(units)) == 1 else units
            variables[name] = (("time", *axis), self[name], {"units": unit})
        coordinates = {
            f"{s.name}_element": np.arange(1, s.size + 1)
            for s in self.signals.values()
            if s.size > 1
        }
        return xarray.Dataset(
            variables, {"time": ("time", self.time, {"units": "s"}), **coordinates}
        )

    def to_arrow(self) -> pa.Table:
        """Return an Arrow table with the columns of `to_pandas`, with the units in its schema."""
        columns = {"time": self.time}
        for signal in self.signals.values():
            for offset, column in enumerate(signal.columns):
                columns[column] = self._values[: self.rows, signal.first + offset]
        units = self.units
        fields = [pa.field(name, pa.float64(), metadata={"unit": units[name]}) for name in columns]
        # pandas stores DataFrame.attrs under this key of the schema.
        metadata: dict[str | bytes, str] = {"PANDAS_ATTRS": json.dumps({"units": units})}
        if self.provenance is not None:
            metadata[KEY] = self.provenance.to_json()
        schema = pa.schema(fields, metadata=metadata)
        # Create the arrays from buffers, because `pa.array` would import pandas.
        arrays = [
            pa.Array.from_buffers(
                pa.float64(), len(values), [None, pa.py_buffer(np.ascontiguousarray(values))]
            )
            for values in columns.values()
        ]
        return pa.table(arrays, schema=schema)

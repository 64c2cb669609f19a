"""ResultTable: a table of a comparison in Python, with conversions and a view for notebooks."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from isonoise.comparison.table_columns import TableColumn
from isonoise.comparison.tidy_tables import arrow_table, csv_text
from isonoise.errors import UserError
from isonoise.tables import LEFT, RIGHT, Column, Table, html_table, text_table

if TYPE_CHECKING:
    import pandas
    import pyarrow

MAX_SHOWN_ROWS = 20
"""Of a table that is printed or shown in a notebook."""


class ResultTable(Mapping[str, np.ndarray]):
    """Columns of a comparison's table by name, as one-dimensional arrays of equal length.

    Missing numbers are nan, missing texts empty.

    Parameters
    ----------
    name : str
        `runs`, `waves` or `summary`.
    arrays : mapping
        The columns.
    columns : sequence of TableColumn
        Their types, units and meanings, in the same order.

    Attributes
    ----------
    name : str
        As given.
    columns : tuple of TableColumn
        Name, type, unit and meaning of every column.
    """

    def __init__(self, name: str, arrays: Mapping[str, np.ndarray], columns: Sequence[TableColumn]):
        self.name, self.columns = name, tuple(columns)
        self._arrays = dict(arrays)

    def __getitem__(self, column: str) -> np.ndarray:
        """The values of a column."""
        return self._arrays[column]

    def __iter__(self) -> Iterator[str]:
        """The names of the columns."""
        return iter(self._arrays)

    def __len__(self) -> int:
        """The number of columns."""
        return len(self._arrays)

    @property
    def row_count(self) -> int:
        """The number of rows."""
        return len(next(iter(self._arrays.values()), ()))

    def to_pandas(self) -> "pandas.DataFrame":
        """The table as a DataFrame of pandas. Raises UserError if pandas is not installed."""
        try:
            import pandas
        except ImportError as error:
            raise UserError("to_pandas needs pandas: pip install pandas") from error
        return pandas.DataFrame({name: _python_texts(values) for name, values in self.items()})

    def to_arrow(self) -> "pyarrow.Table":
        """The table for pyarrow, with unit and meaning of every column. Raises UserError without pyarrow."""
        try:
            return arrow_table(self.name, self, self.columns)
        except ImportError as error:
            raise UserError("to_arrow needs pyarrow: pip install 'isonoise[tables]'") from error

    def to_csv(self) -> str:
        """The table as CSV text: numbers with all their digits, missing ones empty."""
        return csv_text(self)

    def __repr__(self) -> str:
        shown = Table([Column(name) for name in self], self._shown_rows())
        return f"{text_table(shown)}\n{self._size()}"

    def _repr_html_(self) -> str:
        """For notebooks: the first rows, with the meanings of columns as tooltips."""
        meanings = {column.name: f"{column.meaning} [{column.unit}]" for column in self.columns}
        columns = [
            Column(name, LEFT if values.dtype.kind in "UO" else RIGHT, meaning=meanings.get(name, ""))
            for name, values in self.items()
        ]
        table = html_table(Table(columns, self._shown_rows()))
        return f'<div style="overflow-x:auto">{table}<p>{self._size()}</p></div>'

    def _shown_rows(self) -> list[list[str]]:
        columns = [[_cell(value) for value in values[:MAX_SHOWN_ROWS].tolist()] for values in self.values()]
        return [list(row) for row in zip(*columns, strict=True)]

    def _size(self) -> str:
        shown = f", the first {MAX_SHOWN_ROWS} shown" if self.row_count > MAX_SHOWN_ROWS else ""
        return f"{self.name}: {self.row_count} rows{shown}, {len(self)} columns"


def _python_texts(values: np.ndarray) -> np.ndarray:
    """Texts as Python objects: pandas has no type for NumPy's."""
    return values.astype(object) if values.dtype.kind == "U" else values


def _cell(value: object) -> str:
    if isinstance(value, float):
        return "" if np.isnan(value) else f"{value:.4g}"
    return str(value)

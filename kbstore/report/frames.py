"""Relations as Arrow tables, for pandas and polars, and as Parquet files (extra ``frames``: pyarrow)."""

import importlib
import io
from typing import Any

from kbstore.errors import MissingLibrary
from kbstore.report.relations import DataTable, Kind


def arrow_table(found: DataTable) -> Any:
    """Return a relation as a `pyarrow.Table`: times as ``timestamp[ns, UTC]``, None as null.

    Raises `MissingLibrary` if pyarrow is not installed.
    """
    pa = _library()
    types = {
        Kind.TEXT: pa.string(),
        Kind.INTEGER: pa.int64(),
        Kind.NUMBER: pa.float64(),
        Kind.FLAG: pa.bool_(),
        Kind.TIME: pa.timestamp("ns", tz="UTC"),
    }
    schema = pa.schema([(name, types[kind]) for name, kind in found.columns])
    columns = list(zip(*found.rows, strict=True)) or [()] * len(schema)
    arrays = [pa.array(cells, field.type) for cells, field in zip(columns, schema, strict=True)]
    return pa.Table.from_arrays(arrays, schema=schema)


def parquet_bytes(found: DataTable) -> bytes:
    """Return a relation as the bytes of a Parquet file, with times to the nanosecond. Raises `MissingLibrary`."""
    file = io.BytesIO()
    table = arrow_table(found)
    importlib.import_module("pyarrow.parquet").write_table(table, file)
    return file.getvalue()


def _library() -> Any:
    try:
        return importlib.import_module("pyarrow")
    except ImportError as error:
        raise MissingLibrary(
            f"frames need the library pyarrow, which cannot be imported ({error});"
            " install it with: pip install 'kbstore[frames]'"
        ) from None

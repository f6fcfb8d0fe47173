"""Recordings: reading and writing logs of every format.

Importing this package is cheap: the table library is imported where a Parquet file is read or written.
"""

from ur5_twin.recording.lab_writer import write_lab_csv
from ur5_twin.recording.parquet import read_parquet_metadata, write_parquet
from ur5_twin.recording.reading import read
from ur5_twin.recording.table import COLUMN_WIDTHS, Note, Recording, Table

__all__ = [
    "COLUMN_WIDTHS",
    "Note",
    "Recording",
    "Table",
    "read",
    "read_parquet_metadata",
    "write_lab_csv",
    "write_parquet",
]

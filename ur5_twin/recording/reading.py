"""Reading a log, whatever its format: the content tells which."""

from __future__ import annotations

import re
from pathlib import Path

from ur5_twin.errors import RecordingError
from ur5_twin.recording import journal, lab_layout
from ur5_twin.recording.table import Recording

#: The recording in the output folder of a replay.
RECORDING_FILE = "recording.parquet"
#: What a live recording is written to; it stays where the process was killed before it could make the former of it.
JOURNAL_FILE = "recording.journal"
_FORMATS = (
    "a folder of the lab's CSV files, a CSV by ur_rtde or record.py, a Parquet file or journal of ours, "
    "or the output folder of a replay"
)


def read(path: Path | str, *, repair: bool = False) -> Recording:
    """Read a recording; the format is recognised by its content.

    Args:
        path: the lab's folder of CSV files (the movement or its ``csv_files``), a CSV that ur_rtde or Universal Robots'
            record.py wrote, a Parquet file of ours, or the output folder of a replay.
        repair: leave out what is broken, with a note that says so, instead of refusing the log.

    Returns:
        A recording with one table per device, each on the clock of that device, and what the reader found as notes.

    Raises:
        RecordingError: there is no such file, it is in no known format, or it is broken and ``repair`` is off (or
            cannot help). The message names the file, the row where there is one, and what would be right.
    """
    path = Path(path)
    try:
        if path.is_dir():
            return _read_folder(path, repair)
        with path.open("rb") as file:
            head = file.read(4096)
    except FileNotFoundError:
        raise RecordingError(f"{path}: no such file or folder; give {_FORMATS}") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror or error})") from None
    return _read_file(path, head, repair)


def _read_folder(path: Path, repair: bool) -> Recording:
    names = {p.name for p in path.iterdir()}
    if lab_layout.holds_log(path):
        from ur5_twin.recording.lab import read_lab_folder

        return read_lab_folder(path, repair=repair)
    if RECORDING_FILE in names:
        from ur5_twin.recording.parquet import read_parquet

        return read_parquet(path / RECORDING_FILE, repair=repair)
    if JOURNAL_FILE in names:
        return journal.read_settled(path / JOURNAL_FILE, repair=repair)
    raise RecordingError(f"{path}: {_why_not_a_log(path, names)}; give {_FORMATS}")


def _why_not_a_log(path: Path, names: set[str]) -> str:
    files = sorted(name for name in names if name.endswith((".csv", ".parquet")))
    if files:
        return f"none of the lab's files (log_q_actual.csv, ...) in it; if '{files[0]}' is the log, give that file"
    if csv := sorted(found.name for found in path.glob(f"{lab_layout.CSV_FOLDER}/*.csv")):
        return f"no file of the lab's layout (log_q_actual.csv, ...) in this folder, only {csv[0]}"
    movements = sorted(name for name in names if (path / name / lab_layout.CSV_FOLDER).is_dir())
    if movements:
        return f"a folder of {len(movements)} movements, not one; give one of them, '{movements[0]}' for example"
    return "no CSV and no Parquet file in this folder"


def _read_file(path: Path, head: bytes, repair: bool) -> Recording:
    if head.startswith(b"PAR1"):
        from ur5_twin.recording.parquet import read_parquet

        return read_parquet(path, repair=repair)
    if head.startswith(journal.MAGIC):
        return journal.read_settled(path, repair=repair)
    first = head.removeprefix(b"\xef\xbb\xbf").split(b"\n", 1)[0]
    if path.name in lab_layout.KNOWN_FILES or re.fullmatch(rb"[-+0-9.eE,\s]*\d[-+0-9.eE,\s]*", first):
        raise RecordingError(
            f"{path}: rows of numbers without a header, as in one file of the lab's logs; "
            "the files of a run belong together: give the folder that holds them"
        )
    if b"\0" in head:
        raise RecordingError(f"{path}: not a log but binary data; give {_FORMATS}")
    from ur5_twin.recording.rtde_csv import read_rtde_csv

    return read_rtde_csv(path, repair=repair)

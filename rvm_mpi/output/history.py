"""`history.csv`: a row for each time step, written by rank 0."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from rvm_mpi.output.disk import named

HISTORY = "history.csv"


class History:
    """`history.csv`: one row per time step, written by rank 0 alone.

    Parameters
    ----------
    path : the file
    columns : their names, fixed for the whole run; "step" is written as an integer, all others with repr,
        which reads back as the same float
    resume_after : keep an existing file's rows up to this step and go on from there (restart); a last row
        that was cut off is dropped

    Raises
    ------
    ValueError : the existing file has other columns.
    """

    def __init__(self, path: str | Path, columns: Sequence[str], resume_after: int | None = None):
        self.path = Path(path)
        self.columns = tuple(columns)
        header = ",".join(self.columns) + "\n"
        bad = any("," in name or name.split() != [name] for name in self.columns)
        if bad or len(set(self.columns)) != len(self.columns):
            raise ValueError(f"not fit for the columns of a CSV file: {header.strip()}")
        lines = [header]
        if resume_after is not None:
            lines = self.path.read_text(encoding="ascii").splitlines(keepends=True)
            if lines[:1] != [header]:
                found = lines[0].strip() if lines else "none"
                raise ValueError(f"{self.path} has other columns than this run: {found}")
            step = self.columns.index("step")
            whole = (line for line in lines[1:] if line.endswith("\n"))
            lines[1:] = [line for line in whole if int(line.split(",")[step]) <= resume_after]
        part = self.path.with_name(self.path.name + ".part")
        with named(self.path):
            with part.open("w", encoding="ascii") as file:
                file.writelines(lines)
                file.flush()
                os.fsync(file.fileno())  # a crash of the machine must leave one of the two, whole
            part.replace(self.path)
        # without a buffer a row that could not be written is not tried again
        self._file = self.path.open("ab", buffering=0)

    def append(self, row: Mapping[str, float]):
        """Append one row, which must have exactly the columns; it is on its way to disk when this returns.

        Raises
        ------
        ValueError : a column is missing or unknown.
        OSError : it cannot be written.
        """
        if len(row) != len(self.columns) or any(name not in row for name in self.columns):
            wrong = ", ".join(sorted(set(row) ^ set(self.columns)))
            raise ValueError(f"{self.path}: these columns are missing or unknown: {wrong}")
        cells = (str(int(row[name])) if name == "step" else repr(float(row[name])) for name in self.columns)
        line = (",".join(cells) + "\n").encode("ascii")
        with named(self.path):
            written = self._file.write(line)
            if written < len(line):  # the disk took a part of it: why, it says when asked for more
                self._file.write(line[written:])

    def close(self):
        """Close the file."""
        self._file.close()

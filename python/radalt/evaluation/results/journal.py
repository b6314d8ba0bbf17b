"""What a long measurement has so far, a line an entry, so that a killed one goes on where it was."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from .folder import flatten

__all__ = ["Journal", "JournalError"]


class JournalError(ValueError):
    """A file that belongs to another measurement; the message is one line for the user."""


class Journal:
    """Entries of one measurement in a file of JSON lines; the first one says which measurement it is.

    Parameters
    ----------
    path : Path
        Made if it is not there, its folder as well. A last line that was cut by a kill is dropped.
    head : dict
        Everything that an entry depends on.
    resume : bool
        Whether the file may hold a part of this very measurement.

    Attributes
    ----------
    entries : list of dict
        In the order they were added.
    resumed : bool
        Whether some were there already.

    Raises
    ------
    JournalError
        If it holds entries and ``resume`` is off, or those of another measurement; names the first difference.
    """

    def __init__(self, path: Path, head: dict[str, Any], *, resume: bool) -> None:
        self.path = path
        self.entries: list[dict[str, Any]] = []
        head = json.loads(json.dumps(head))  # as JSON gives it back
        held = self._read()
        if held:
            self._check(held[0], head, resume)
            self.entries = held[1:]
        self.resumed = bool(self.entries)
        path.parent.mkdir(parents=True, exist_ok=True)
        fresh = path.with_suffix(".tmp")
        fresh.write_text("".join(json.dumps(e) + "\n" for e in [head, *self.entries]), encoding="utf-8")
        fresh.replace(path)

    def _read(self) -> list[dict[str, Any]]:
        try:
            text = self.path.read_text(encoding="utf-8")
            # the last line counts only with its end
            return [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()]
        except FileNotFoundError:
            return []
        except (OSError, ValueError) as error:
            reason = str(error).splitlines()[0]
            raise JournalError(f"{self.path}: cannot be read ({reason}); delete it to start anew") from None

    def _check(self, held: dict[str, Any], head: dict[str, Any], resume: bool) -> None:
        if not resume:
            raise JournalError(
                f"{self.path} holds an unfinished run; add --resume to go on with it, or delete it to start anew"
            )
        mine, have = flatten(head), flatten(held)
        for key in [*mine, *(k for k in have if k not in mine)]:
            if mine.get(key) != have.get(key):
                raise JournalError(
                    f"{self.path} holds another run: {key} is {have.get(key)!r} there and {mine.get(key)!r} here; "
                    "repeat that run's options, or delete it to start anew"
                )

    def add(self, entry: dict[str, Any]) -> None:
        """Append an entry and push it to the disk."""
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")
            file.flush()
            os.fsync(file.fileno())
        self.entries.append(json.loads(json.dumps(entry)))

    def of(self, kind: str) -> list[dict[str, Any]]:
        """Entries whose ``kind`` is this."""
        return [entry for entry in self.entries if entry["kind"] == kind]

    def close(self) -> None:
        """The measurement is complete and written elsewhere: remove the file."""
        self.path.unlink()

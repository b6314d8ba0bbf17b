"""The study of a list: entries on every case, levels from high to low, on the engine of all studies."""

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

from ..core.mitigation import METHODS, method_class
from ..evaluation.engine.own import option_files, with_option_files
from ..evaluation.engine.study import Point, Study
from ..evaluation.results.rows import Columns
from .entry import Entry, flowgraph_of, run
from .frames import frames_of
from .lists import Case, CaseList, load_list
from .rows import COLUMNS, read_rows, row_of
from .turns import TURN_COLUMNS, turn_rows


@dataclass(frozen=True)
class BenchPoint(Point):
    """A case of the list, at all of its levels."""

    number: int = 0


@dataclass(frozen=True)
class BenchStudy(Study):
    """Entries on the cases of a list; parameters as in `load_list`, and ``via``: ``"direct"`` or ``"flowgraph"``."""

    path: Path
    entries: tuple[Entry, ...]
    frames: int | None = None
    only: tuple[str, ...] = ()
    salt: str = ""
    via: str = "direct"
    stored: Path | None = (
        None  # rows given instead of measured ones; those of the cost are in its folder `turns`
    )
    tables: ClassVar[dict[str, Columns]] = {"rows": COLUMNS, "turns": TURN_COLUMNS}
    cases: CaseList = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        cases = load_list(self.path, frames=self.frames, only=self.only, salt=self.salt)
        object.__setattr__(self, "cases", cases)

    def head(self) -> dict[str, Any]:
        """See `Study.head`: the list's digest, and what each entry is, hashes of models and files included."""
        waveform = self.cases.cases[0].scene.waveform
        entries = {}
        for entry in self.entries:
            status = entry.build(waveform).status()
            about = {k: v for k, v in entry.options if k not in ("model", "file", "method")}
            about |= dict(entry.altimeter) | ({"detector": entry.detector} if entry.detector else {})
            entries[entry.name] = {"method": entry.method, "sha256": status.get("sha256", "")} | about
        head = {"list": self.cases.name, "digest": self.cases.digest, "entries": entries}
        more = {"via": self.via} if self.via != "direct" else {}
        return head | more | ({"stored": str(self.stored)} if self.stored else {})

    def points(self) -> list[BenchPoint]:
        """See `Study.points`: a point per case and overlap, since an entry stops after levels that failed."""
        points = [
            BenchPoint(f"{c.name}, overlap {c.overlap:g}", c.trials * len(c.levels_db), "rows", number)
            for number, c in enumerate(self.cases.cases)
        ]
        if self.cases.turns:
            points.append(BenchPoint("cost by turns", self.cases.turns * 8 * len(points), "turns"))
        return points

    def measure(self, point: Point) -> list[dict[str, Any]]:
        assert isinstance(point, BenchPoint)
        for entry in self.entries:
            entry.register()
        if self.stored is not None:
            turned = point.table == "turns"
            path = self.stored.parent / "turns" / self.stored.name if turned else self.stored
            case = None if turned else self.cases.cases[point.number]
            return [
                row
                for row in (read_rows(path, self.tables[point.table]) if path.is_file() else ())
                if case is None or (row["case"], row["overlap"]) == (case.name, case.overlap)
            ]
        if point.table == "turns":
            cases = ((case, case.levels_db[len(case.levels_db) // 2]) for case in self.cases.cases)
            frames = [(case, frames_of(case, level_db)) for case, level_db in cases]
            return list(turn_rows(self.entries, frames, self.cases.turns))
        with tempfile.TemporaryDirectory(prefix="radalt_bench_") as folder:
            return list(self._rows(self.cases.cases[point.number], Path(folder)))

    @property
    def max_jobs(self) -> int | None:  # type: ignore[override]
        """See `Study.max_jobs`: a list with turns is measured in one process."""
        return 1 if self.cases.turns else None

    def _rows(self, case: Case, folder: Path) -> Iterator[dict[str, Any]]:
        failed, flowgraphs = dict.fromkeys(self.entries, 0), {}
        if self.via == "flowgraph":
            flowgraphs = {entry: flowgraph_of(entry, case.scene, folder / entry.name) for entry in failed}
        for level_db in case.levels_db:
            running = [entry for entry, count in failed.items() if count < case.grid.stop_after]
            if not running:
                return
            frames = frames_of(case, level_db)
            for entry in running:
                names, out = (self.cases.name, self.cases.digest), run(entry, frames)
                if flowgraphs:  # the cost stays that of one frame at a time
                    out = replace(out, results=flowgraphs[entry](frames.scene))
                row = row_of(names, case, entry, frames, out)
                failed[entry] = failed[entry] + 1 if row["pd"] < case.grid.stop_below_pd else 0
                yield row

    def files(self) -> dict[str, Path]:
        """See `Study.files`: the list, and the users' files."""
        return {"list": Path(self.path)} | option_files({e.name: dict(e.options) for e in self.entries})

    def with_files(self, files: Mapping[str, Path]) -> "BenchStudy":
        options = with_option_files({e.name: dict(e.options) for e in self.entries}, files)
        entries = tuple(replace(e, options=tuple(options[e.name].items())) for e in self.entries)
        return replace(self, path=files["list"], entries=entries)

    @property
    def needs_network(self) -> bool:
        return any(method_class(e.method).runs_network for e in self.entries if e.method in METHODS)

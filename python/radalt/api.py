"""The package from Python, without a flowgraph: what `import radalt` offers next to the blocks.

    import radalt

    w = radalt.Waveform()
    frames, truth_m = radalt.simulate("nr10", sir_db=-40, overlap=1, frames=200, seed=1)
    result = radalt.Altimeter(w).process(radalt.method("ofdm_cancel", w).process(frames))
    report = radalt.evaluate("nr10", methods=["none", "tcae"], sir_db=range(-60, 0, 5))
    print(report.break_points())

Nothing here needs GNU Radio.
"""

import dataclasses
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .core.channel.settings import DropSettings
from .core.interrupts import stops_in_one_line
from .core.mitigation import CUSTOM, METHODS, Mitigation, MitigationError, create
from .core.mitigation.function import MethodLike, as_methods
from .core.parsing import convert, did_you_mean, plain_json, shown
from .core.paths import scene_names
from .core.scene import Scene, SceneError, load_scene, parse_scene, scene_from_parameters
from .core.usual_errors import usual_errors
from .core.waveform import Waveform, checked

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .evaluation.results.rowtable import Table

__all__ = ["Names", "Report", "evaluate", "method", "methods", "scenes", "simulate"]

Numbers: TypeAlias = "float | Iterable[float] | None"
SceneLike: TypeAlias = "str | Path | Scene | dict[str, Any]"


class Names(tuple[str, ...]):
    """Names that exist: a tuple whose entries are attributes too, for completion by the Tab key.

    Examples
    --------
    >>> Names(["nr5", "nr10"]).nr10
    'nr10'
    """

    __slots__ = ()

    def __getattr__(self, name: str) -> str:
        if name in self:
            return name
        raise AttributeError(f"there is no {name!r}; there are: {', '.join(self)}")

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self]


def scenes() -> Names:
    """Names of the shipped scenes; `radalt.scenes` is this list."""
    return Names(scene_names())


def methods() -> Names:
    """Registry names of the methods, in the order of reports; `radalt.methods` is this list."""
    return Names(METHODS)


def method(name: MethodLike, waveform: Waveform, **options: Any) -> Mitigation:
    """A fresh mitigation method; its ``process`` cleans (n, N) complex64 frames.

    Parameters
    ----------
    name : str, function or class
        One of `radalt.methods`; ``"custom"`` with ``file="mine.py"``; a function of (n, N) complex64 frames and the
        waveform that returns cleaned frames; or a subclass of `Mitigation`.
    waveform : Waveform
        The sweep that frames are aligned with.
    **options
        Of the method: the keys of ``method_options`` in a scene.

    Raises
    ------
    MitigationError
        For an unknown name or option; names what is allowed.

    Examples
    --------
    >>> import radalt
    >>> radalt.method("whitening", radalt.Waveform()).name
    'whitening'
    """
    with as_methods([name]) as (known,):
        return create(known, checked(waveform), **options)


@stops_in_one_line()
@usual_errors()
def simulate(
    scene: SceneLike = "paper_qpsk",
    *,
    sir_db: float | None = None,
    overlap: float | None = None,
    snr_db: float | None = None,
    altitude_m: float | Iterable[float] | None = None,
    frames: int | None = None,
    seed: int | None = None,
    auxiliary: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Received frames of a scene, aligned with the sweep, and the altitudes that they were made for.

    Sources, interference and channel are those of the flowgraphs. Timing is known: samples are neither lost nor late
    by a fraction, so `Altimeter.process` needs no timing offset. `evaluate` has the segmenter as well.

    Parameters
    ----------
    scene : str, Path, dict or Scene
        One of `radalt.scenes`, a YAML file, its content, or `load_scene`'s result: in a loop the latter, since
        reading a file takes longer than making a frame.
    sir_db, overlap, snr_db : float, optional
        Signal to all interference over the whole frame, active fraction of the frame (0..1), signal to noise; default
        the scene's.
    altitude_m : float or iterable of float, optional
        Altitudes in metres, in the order they are flown; default the scene's.
    frames : int, optional
        How many, spread evenly over the altitudes; default the scene's number at each altitude.
    seed : int, optional
        Everything random follows from it; default the scene's.
    auxiliary : bool
        Frames of both receive channels, of a scene with ``auxiliary``, before `AuxiliaryCancel`.

    Returns
    -------
    (n, N) complex64, (n,) float64
        Frames, or (n, 2, N) of both channels, and true altitudes in metres.

    Raises
    ------
    SceneError
        For a value that does not fit; one line.

    Examples
    --------
    >>> import radalt
    >>> frames, truth_m = radalt.simulate("nr10", sir_db=-20, altitude_m=[300, 100], frames=6, seed=1)
    >>> frames.shape, truth_m
    ((6, 7500), array([300., 300., 300., 100., 100., 100.]))
    """
    from .evaluation.overlap.points import changed
    from .evaluation.simulation import both_received

    chosen = _scene(scene)
    level = _numbers(float, overlap=overlap, sir_db=sir_db, snr_db=snr_db)
    frames, seed = _numbers(int, frames=frames, seed=seed).values()
    (flown,) = _numbers(tuple[float, ...], altitude_m=altitude_m).values()
    chosen = changed(chosen, altitudes_m=flown, frames=_per_altitude(chosen, flown, frames), seed=seed)
    snr_db = level.pop("snr_db")
    chosen = scene_from_parameters(chosen, **level)
    try:
        chosen = chosen.at(snr_db=snr_db)
        # a latency of one frame: what comes in with frame k is sweep k - 1, to the sample
        n = chosen.waveform.samples_per_frame
        channel = dataclasses.replace(chosen.channel, start_offset_samples=float(n), drops=DropSettings())
        chosen = dataclasses.replace(chosen, channel=channel)
        programme = chosen.altitude.programme
        if auxiliary and chosen.auxiliary is None:
            raise ValueError(
                "it has one receive channel; give it a section auxiliary, or leave auxiliary off"
            )
        trial = np.flatnonzero(programme.is_trial(np.arange(programme.total_frames)))[:frames]
        pieces = list(both_received(chosen, int(trial[-1]) + 2, trials_only=True))
    except ValueError as error:
        raise SceneError(f"scene {chosen.name}: {error}") from None
    at, truth_m = trial + 1 - pieces[0][0] // n, programme.altitude_m(trial)
    first = np.concatenate([samples for _, samples, _ in pieces]).reshape(-1, n)[at]
    if not auxiliary:
        return first, truth_m
    second = np.concatenate([samples for *_, samples in pieces if samples is not None]).reshape(-1, n)[at]
    return np.stack([first, second], axis=1), truth_m


def _scene(scene: SceneLike) -> Scene:
    if isinstance(scene, dict):
        return parse_scene(scene)
    return scene if isinstance(scene, Scene) else load_scene(scene)


def _numbers(kind: Any, **given: Any) -> dict[str, Any]:
    """Arguments by name as numbers of a kind, or None; raises SceneError, one line."""
    try:
        return {name: convert(kind | None, value, name) for name, value in given.items()}
    except ValueError as error:
        raise SceneError(str(error)) from None


def _per_altitude(scene: Scene, altitudes_m: tuple[float, ...] | None, frames: int | None) -> int | None:
    """Frames at each altitude, for so many in all."""
    if frames is None:
        return None
    if frames < 1:
        raise SceneError(f"frames is {frames}; it has to be at least 1")
    count = len(altitudes_m or scene.altitude.programme_m)
    if scene.return_model == "terrain":
        if frames > count:
            raise SceneError(f"frames is {frames}, and the landing has {count}; set altitude.landing_frames")
        return None
    return -(-frames // count)


@stops_in_one_line()
@usual_errors()
def evaluate(
    scene: SceneLike = "paper_qpsk",
    methods: MethodLike | Sequence[MethodLike] | None = None,
    *,
    overlap: Numbers = None,
    sir_db: Numbers = None,
    snr_db: Numbers = None,
    altitude_m: Numbers = None,
    frames: int | None = None,
    seed: int | None = None,
    out: str | Path | None = None,
    resume: bool = False,
    jobs: int = 1,
    progress: bool = True,
) -> "Report":
    """Measure methods over overlap, SIR and SNR, as ``radalt eval --sim`` does, without a flowgraph.

    The parts of the flowgraph are called one after the other: for the same scene and seed the rows are the same.

    Parameters
    ----------
    scene : str, Path, dict or Scene
        One of `radalt.scenes`, a YAML file, its content, or `load_scene`'s result.
    methods : sequence, optional
        What is compared on the same frames, each as in `method`, or one of these alone; default the scene's.
    overlap, sir_db, snr_db : number or iterable of numbers, optional
        Axes of the sweep; default the scene's. With three SIRs or more there are break-points.
    altitude_m : number or iterable of numbers, optional
        Altitudes in metres, in the order they are flown; default the scene's.
    frames : int, optional
        Trials per point, rounded up to the same number at each altitude; default the scene's.
    seed : int, optional
        Everything random follows from it; default the scene's.
    out : path, optional
        Result folder; by default the rows stay in memory and nothing is written.
    resume : bool
        Complete the run that ``out`` holds.
    jobs : int
        1 measures in this process. More are worker processes: a script then needs ``if __name__ == "__main__":``, and
        functions of your own belong into a file (the method ``custom``).
    progress : bool
        Show a bar on a terminal, a line per point elsewhere.

    Raises
    ------
    SceneError, MitigationError, FolderError, WorkerError
        For what does not fit, one line; the rows so far are kept in ``out``.
    KeyboardInterrupt
        At Ctrl-C, one line: how many points are kept. (While ``radalt.evaluate`` itself is imported, a traceback.)
    """
    from .evaluation.engine.command import Bar
    from .evaluation.engine.options import MAX_JOBS, Options
    from .evaluation.engine.run import head_of, in_memory, run
    from .evaluation.overlap.points import changed
    from .evaluation.overlap.report import build_report
    from .evaluation.overlap.study import OverlapStudy, describe_rows
    from .evaluation.results.folder import FolderError

    chosen = _scene(scene)
    if methods is not None and (isinstance(methods, str) or not isinstance(methods, Iterable)):
        methods = [methods]
    axes = _numbers(tuple[float, ...], overlap=overlap, sir_db=sir_db, snr_db=snr_db, altitude_m=altitude_m)
    flown = axes.pop("altitude_m")
    frames, seed, jobs = _numbers(int, frames=frames, seed=seed, jobs=jobs).values()
    if not (jobs and 1 <= jobs <= MAX_JOBS):
        raise SceneError(f"jobs is {jobs}; it has to be within 1..{MAX_JOBS}")
    if not isinstance(out, (str, Path, NoneType)):
        raise FolderError(f"out is {shown(out)}; name a folder")
    if resume and out is None:
        raise FolderError("resume needs out, the folder of the run to complete")
    if jobs > 1 and any(not isinstance(m, str) for m in methods or ()):
        raise MitigationError(
            f"jobs is {jobs}, and a function is known to this process alone; leave jobs at 1, or put it into a file: "
            f"method {CUSTOM!r} with method_options {{{CUSTOM}: {{file: mine.py}}}}"
        )
    with as_methods(chosen.methods if methods is None else methods) as names:
        each = _per_altitude(chosen, flown, frames)
        chosen = changed(chosen, **axes, altitudes_m=flown, frames=each, seed=seed, methods=names)
        study = OverlapStudy(chosen, flowgraph=False)
        study.check()
        bar, workers = Bar(describe_rows, quiet=not progress), jobs if jobs > 1 else 0
        try:
            if out is None:
                rows, facts = in_memory(study, workers, bar)
                content = build_report(head_of(study), chosen, rows, facts, left_out=study.left_out())
                return Report(None, json.loads(json.dumps(plain_json(content))))
            run(study, Options(out=Path(out), resume=resume, jobs=workers), bar)
        except KeyboardInterrupt:
            if out is None or bar.last is None:
                raise
            kept = f"{bar.last.done} of {bar.last.total} points are kept"
            raise KeyboardInterrupt(f"stopped; {kept}, go on with resume=True and out={str(out)!r}") from None
        finally:
            bar.close()
    return Report.read(out)


@dataclass(frozen=True)
class Report:
    """Result of `evaluate`, or of any run of ``radalt eval`` and ``radalt collect`` (`Report.read`)."""

    folder: Path | None
    """Result folder: report.json, report.md, report.html, rows.csv, figures, the scene as used; None in memory."""
    content: dict[str, Any] = dataclasses.field(repr=False)
    """``report.json``."""

    @classmethod
    def read(cls, folder: str | Path) -> "Report":
        """The report of a finished run; raises FolderError, one line, where there is none."""
        from .evaluation.results.folder import read_report

        return cls(Path(folder), read_report(Path(folder)))

    @property
    def html(self) -> Path:
        """The whole report as one page, ``report.html``; raises FolderError for a report in memory."""
        from .evaluation.results.folder import FolderError

        if self.folder is None:
            raise FolderError("the report is in memory; evaluate(..., out=FOLDER) writes it")
        return self.folder / "report.html"

    @property
    def table(self) -> "Table":
        """One row per method and point: Pd with its 95 % interval, wrong and valid, errors, time per frame."""
        from .evaluation.results.rowtable import Table

        return Table(self.content["rows"], _SHOWN)

    def break_points(self) -> "Table":
        """Lowest SIR at which Pd is at least 0.9, and the gain over ``none``; no rows with fewer than three SIRs.

        ``text`` and ``protection_gain`` have the mark of an open end (<= or >=), where the SIRs measured end first.
        """
        from .evaluation.results.rowtable import Table

        return Table(self.content["break_points"], _BREAK_POINTS)

    def plot(self, against: str | None = None) -> "Figure":
        """Pd with 95 % intervals as a figure of matplotlib's pyplot.

        Parameters
        ----------
        against : str, optional
            ``"sir_db"`` or ``"overlap"``; default the SIR where there are break-points.

        Raises
        ------
        ValueError
            For another axis.
        """
        from .evaluation.overlap.figures import draw_pd

        if against not in (None, *_AXES):
            near = did_you_mean(against, _AXES)
            raise ValueError(f"against is {against!r}; {near}there are: {', '.join(_AXES)}")
        axis = against or ("sir_db" if self.content["break_points"] else "overlap")
        figure: Figure = draw_pd(self.content["rows"], None, title=self.content["title"], against=axis)
        return figure

    def to_numpy(self) -> np.ndarray:
        """`table` as a structured array."""
        return self.table.to_numpy()

    def to_pandas(self) -> Any:
        """`table` as a pandas DataFrame; raises ImportError where pandas is not installed."""
        return self.table.to_pandas()

    def __str__(self) -> str:
        """Ten lines at most: title, break-points or points, as many as fit, and the page."""
        parts = (("break_points()", self.break_points()), ("table", self.table))
        name, rows = next((name, rows) for name, rows in parts if len(rows))
        lines = [self.content["title"].replace("\n", ", "), *str(rows[:5]).splitlines()]
        more = len(rows) - 5
        lines += [f"and {more} more: report.{name}"] * (more > 0)
        lines += [] if self.folder is None else [str(self.html)]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """For notebooks."""
        return self.table._repr_html_()


_AXES = ("sir_db", "overlap")
_SHOWN = ("method", "overlap", "sir_db", "snr_db", "trials", "pd", "pd_low", "pd_high", "rmse_forced_m")
_BREAK_POINTS = "method interference overlap snr_db text low_db high_db protection_gain".split()

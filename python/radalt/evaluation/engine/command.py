"""Running a study from a command line: extent, progress, one line for each error."""

import errno
import os
import shlex
import shutil
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ..results.folder import FolderError, RunFolder, check_writable
from ..results.table import counted
from .options import EXPECTED, Options, Terminated, complain, duration, named
from .run import Progress, head_of, run
from .study import Study

_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)


class Bar:
    """Progress bar on a terminal, one line per point elsewhere."""

    def __init__(self, describe: Callable[[Sequence[dict]], str], *, quiet: bool = False) -> None:
        self._describe, self._quiet, self._bar, self._told = describe, quiet, None, False
        self.last: Progress | None = None

    def __call__(self, p: Progress) -> None:
        self.last = p
        if self._quiet:
            return
        if p.rejected and not self._told:
            self._told = True
            more = f" and {len(p.rejected) - 1} others" if len(p.rejected) > 1 else ""
            print(f"{p.rejected[0]}{more}: cut, changed or of another run; measured again", flush=True)
        if sys.stderr.isatty():
            self._show(p)
        elif p.rows:
            print(f"[{p.done}/{p.total}] {self._describe(p.rows)}", flush=True)
        elif p.resumed:
            print(f"going on: {p.done} of {p.total} points are there", flush=True)

    def _show(self, p: Progress) -> None:
        from tqdm import tqdm

        if self._bar is None:
            self._bar = tqdm(total=p.frames, unit="frame", dynamic_ncols=True)
        self._bar.set_description(f"{p.done} of {counted(p.total, 'point')}", refresh=False)
        self._bar.update(p.measured - self._bar.n)

    def close(self) -> None:
        """End the bar's line."""
        if self._bar is not None:
            self._bar.close()


def main(
    study: Study,
    options: Options,
    *,
    program: str,
    dry_run: bool,
    describe: Callable[[Sequence[dict]], str] = lambda rows: ", ".join(map(str, rows[0].values()))[:120],
    after: Callable[[Path], int | None] = lambda folder: None,
) -> int:
    """Run a study that is checked; returns the exit status.

    The status is 0, 2 after one line about an error, 130 when interrupted, 143 when terminated. ``after`` is called
    with the result folder, prints a summary, and may return another status.
    """
    begin, program = time.monotonic(), named(program)
    bar = Bar(describe)
    try:
        if options.publish is not None:
            if not study.published:
                raise FolderError(f"--publish {options.publish}: this study has no page in the documentation")
            check_writable("--publish", options.publish)  # the page is copied after hours of measurement
        points = study.points()
        frames = counted(sum(p.frames for p in points), "frame")
        print(f"{program}: {counted(len(points), 'point')}, {frames} -> {options.out}", flush=True)
        if dry_run:
            RunFolder(options.out, head_of(study), resume=options.resume, dry=True)
            return 0
        page = run(study, options, bar)
        bar.close()
        shown = [page] if options.publish is None else publish(options.out, study.published, options.publish)
        status = after(options.out)
    except EXPECTED as error:
        bar.close()
        complain(program, _said(error, options))
        return 2
    except KeyboardInterrupt as error:
        bar.close()
        ended = "terminated" if isinstance(error, Terminated) else "stopped"
        print(f"\n{program}: {ended}{_kept(options, bar.last)}", file=sys.stderr)
        return 143 if ended == "terminated" else 130
    print(f"\n{', '.join(map(str, shown))}  ({duration(time.monotonic() - begin)})")
    return status or 0


def publish(result: Path, files: Mapping[str, str], target: Path) -> list[Path]:
    """Copy files of a finished run into ``target``, by `Study.published`; links between them follow in Markdown.

    A table without rows has no file. Files of these names are replaced.
    """
    out = []
    for source, name in files.items():
        if source.endswith(".csv") and not (result / source).exists():
            continue
        path = target / name
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(result / source, path)
        if path.suffix == ".md":
            text = path.read_text(encoding="utf-8")
            for other, its_name in files.items():
                text = text.replace(f"]({other})", f"]({os.path.relpath(its_name, Path(name).parent)})")
            path.write_text(text, encoding="utf-8")
        out.append(path)
    return out


def _said(error: Exception, options: Options) -> Exception | str:
    """The error, or a line for a disk that is full or failing."""
    if not isinstance(error, OSError) or error.errno not in _DISK:
        return error
    kept = "the points so far are kept: mend that and go on with --resume"
    return f"{error.filename or options.out} cannot be written ({error.strerror}); {kept}"


def _kept(options: Options, last: Progress | None) -> str:
    """Stored points of an interrupted run and the command that resumes it; empty if there are none."""
    if last is None:
        return ""
    called, *arguments = sys.argv
    words = [*(called.split() if called.startswith("radalt ") else [sys.executable, called]), *arguments]
    if Path(called).resolve().parent.name == "training":  # these programs find the package by PYTHONPATH
        words.insert(0, f"PYTHONPATH={os.environ.get('PYTHONPATH', '')}")
    if not any(word == "--out" or word.startswith("--out=") for word in words):
        words += ["--out", str(options.out)]
    resuming = shlex.join(words if options.resume else [*words, "--resume"])
    return f"; {last.done} of {last.total} points are kept, go on with: {resuming}"

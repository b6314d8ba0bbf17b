"""Try foreign code in a process of its own first, since it may never end, or may end the whole program.

A method file is a program and an ONNX file is one too. A loop without end while it is loaded, or ``os._exit(0)``, would
hang our command or end it with status 0 and without a word. In the trial run only the trial run's process is lost.
"""

import dataclasses
import functools
import json
import multiprocessing
import os
import secrets
import subprocess
import sys
from pathlib import Path

from ..parsing import InputError, check_file
from ..waveform import Waveform
from .base import MitigationError

LIMIT_S = 60.0  # longest time for loading and one frame, s; a network takes a second or two
# Method of each kind of file, and its option that names the file.
_METHODS = {"method file": ("custom", "file"), "tcae model": ("tcae", "model")}
MOST_BYTES = {"method file": 4 << 20, "tcae model": 2 << 30}
_FLAG = "RADALT_TRIAL_RUN"
# The process imports the package by the parent's name for it, since a file may name the package, too.
_PROGRAM = "import sys; sys.path[:] = {path!r}; from {module} import perform; perform({link})"


def try_out(what: str, waveform: Waveform, *files: Path) -> None:
    """Build the method of foreign files in another process and clean a frame; files already tried return at once.

    Worker processes skip it: their work has a time limit, and the program that started them made the trial run.

    ``what``: "method file" or "tcae model"; ``*files``: one, or a network's encoder and decoder. Raises
    `MitigationError`: the file cannot be read, does not end within `LIMIT_S`, ends its process, or what the method
    itself refuses.
    """
    try:
        for file in files:
            check_file(file, most_bytes=MOST_BYTES[what], what=what)
    except InputError as error:
        raise MitigationError(str(error)) from None
    if _FLAG in os.environ or multiprocessing.parent_process() is not None:
        return
    written = tuple((status.st_mtime_ns, status.st_size) for status in (file.stat() for file in files))
    problem = _tried(what, "+".join(str(file.resolve()) for file in files), written, waveform)
    if problem:
        raise MitigationError(problem)


@functools.lru_cache(maxsize=64)
def _tried(what: str, file: str, written: tuple[tuple[int, int], ...], waveform: Waveform) -> str:
    """What is wrong with a file, or two, by its name, time and size; empty for nothing."""
    del written  # another file of the same name is another key
    read, write = os.pipe()
    program = _PROGRAM.format(path=sys.path, module=__name__, link=write)
    word = secrets.token_hex(8)  # proof that it got to the end: foreign code may exit with any status
    method, key = _METHODS[what]
    request = {
        "method": method,
        "options": {key: file},
        "waveform": dataclasses.asdict(waveform),
        "word": word,
    }
    with os.fdopen(read, "rb") as answer:
        process = subprocess.Popen(
            [sys.executable, "-c", program],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=(write,),
            env=os.environ | {_FLAG: "1"},
        )
        os.close(write)
        try:
            process.communicate(json.dumps(request).encode(), timeout=LIMIT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            return f"{what} {file}: did not load and clean a frame within {LIMIT_S:g} s; is there a loop without end?"
        text = answer.read(4096).decode("utf-8", "replace")
    if text == word:
        return ""
    if text.startswith("E "):
        return text[2:]
    return f"{what} {file}: it ended its process (status {process.returncode}) instead of giving frames; leave out exit"


def perform(link: int) -> None:
    """What the trial run's process does: build the method, clean one frame, say so."""
    from . import create

    request = json.load(sys.stdin)
    with os.fdopen(link, "w", encoding="utf-8") as answer:
        try:
            waveform = Waveform(**request["waveform"])
            method = create(request["method"], waveform, **request["options"])
            method.process(waveform.reference[None].copy())
            answer.write(request["word"])
        except MitigationError as error:
            answer.write(f"E {error}")

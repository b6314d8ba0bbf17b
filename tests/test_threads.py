"""Scratch buffers of threads: never shared, bounded, and never in a threading.local, which ends a flowgraph."""

import ast
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from scipy.linalg import blas
from waiting import ran_python

from radalt.core.altimeter.decimator import Decimator

# A source that does what `statement` says with a threading.local in each call; it needs nothing of radalt.
FLOWGRAPH = """
import threading
import numpy as np
from gnuradio import blocks, gr

local = threading.local()

class source(gr.sync_block):
    def __init__(self):
        gr.sync_block.__init__(self, "source", None, [np.float32])
        self.calls = 0

    def work(self, input_items, output_items):
        {statement}
        self.calls += 1
        return -1 if self.calls > 1000 else len(output_items[0])

top = gr.top_block()
block = source()
top.connect(block, blocks.null_sink(gr.sizeof_float))
top.run()
print("ran to its end", flush=True)
"""


def run_flowgraph(statement: str) -> subprocess.CompletedProcess:
    return ran_python("-c", FLOWGRAPH.format(statement=statement))


def test_array_in_a_thread_local_ends_a_flowgraph_from_python_3_13_on():
    """GNU Radio's gateway makes and clears a Python thread state with every call of ``work``.

    The array dies in that clearing, and on Python 3.13.5 with GNU Radio 3.10.12 the process with it: its memory is
    freed without the GIL, as PYTHONDEVMODE=1 says before it aborts. Where this test fails because the flowgraph ran,
    the ban on threading.local can be looked at again.
    """
    done = run_flowgraph("local.scratch = np.zeros(3)")
    if sys.version_info < (3, 13):
        assert (done.returncode, done.stdout) == (0, "ran to its end\n"), done.stderr
    else:
        assert (-done.returncode, done.stdout) in [(signal.SIGSEGV, ""), (signal.SIGABRT, "")], done.stderr
        if sys.flags.dev_mode:
            assert "allocator called without holding the GIL" in done.stderr


ALLOWED = (
    "local.scratch = [self.calls]",
    "getattr(local, 'scratch', None)",
    "self.__dict__.setdefault(threading.get_ident(), np.zeros(3))",
    "np.errstate(all='ignore').__enter__()",
    "threading.current_thread()",
    "np.fft.fft(np.ones(16))",
)


def test_what_a_block_may_do_on_every_python():
    """Objects without an array, a dictionary by thread, and what NumPy and Python keep by thread themselves."""
    done = run_flowgraph("; ".join(ALLOWED))
    assert (done.returncode, done.stdout) == (0, "ran to its end\n"), done.stderr


def test_no_module_of_the_package_uses_a_thread_local(root):
    """Nor does a program; `from threading import local` counts as well."""
    files = [*(root / "python/radalt").rglob("*.py"), *(root / "flowgraphs").glob("*.py")]
    assert len(files) > 100
    guilty = []
    for file in files:
        for node in ast.walk(ast.parse(file.read_text())):
            named = isinstance(node, ast.Attribute) and ast.unparse(node) == "threading.local"
            imported = isinstance(node, ast.ImportFrom) and node.module in ("threading", "_threading_local")
            if named or (imported and any(name.name == "local" for name in node.names)):
                guilty.append(f"{file.relative_to(root)}:{node.lineno}")
    assert guilty == []


def decimator() -> Decimator:
    return Decimator(3750, 7.5e6, 246e3)


def decimated(shared: Decimator, frames: np.ndarray) -> np.ndarray:
    return shared.mix(frames, np.ones(frames.shape[1:], np.complex64))


class MeetingBlas:
    """SciPy's BLAS, whose product begins when every thread is there."""

    def __init__(self, meet: threading.Barrier) -> None:
        self._meet = meet

    def sgemm(self, *args, **options):
        self._meet.wait(timeout=120)
        return blas.sgemm(*args, **options)


def test_threads_that_share_a_decimator_share_no_scratch(monkeypatch):
    """All mix before any filters: with one buffer between them all but the last would get another's samples."""
    count, rng = 6, np.random.default_rng(3)
    blocks = rng.standard_normal((count, 4, 2, 7500)).view(complex).astype(np.complex64)
    wanted = [decimated(decimator(), block) for block in blocks]
    shared, meet = decimator(), threading.Barrier(count)
    monkeypatch.setattr("radalt.core.altimeter.decimator.blas", MeetingBlas(meet))
    with ThreadPoolExecutor(count) as pool:
        for _ in range(5):
            found = list(pool.map(lambda block: decimated(shared, block), blocks))
            for one, other in zip(found, wanted, strict=True):
                np.testing.assert_array_equal(one, other)

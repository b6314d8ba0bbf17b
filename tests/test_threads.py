"""Scratch buffers of threads: never shared, bounded, and never in a threading.local, which ends a flowgraph."""

import ast
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from scipy.linalg import blas

from radalt.core.altimeter.decimator import Decimator


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

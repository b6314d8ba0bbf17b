"""What tests of hostile input share: run a command in this process, and the two ends that are allowed."""

import contextlib
import io
from pathlib import Path

import pytest
import yaml

from radalt.core.scene import Scene, scene_to_mapping
from radalt.evaluation.results.figure import save_figure

MOST = 300  # characters of the one line


def ended(main, *arguments: object) -> tuple[int, str]:
    """Status and stderr of a command; anything that it lets out comes out here, too."""
    err = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(err):
        try:
            status = main([str(a) for a in arguments])
        except SystemExit as end:
            status = end.code
    return status, err.getvalue()


def measure_here(patch, first=lambda: None) -> None:
    """Points of a run are measured in this process, after ``first()``: when the command has read what it reads."""
    patch.setattr(
        "radalt.evaluation.engine.run.run_tasks",
        lambda function, tasks, **_: (first(), ((k, function(task)) for k, task in enumerate(tasks)))[1],
    )


def draw_nothing(patch) -> None:
    """Figures of a run are files without a picture."""

    def write(figure: object, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        for kind in (".png", ".pdf", ".svg"):
            path.with_suffix(kind).write_text("<svg></svg>")

    patch.setattr(save_figure, "__code__", write.__code__)  # whoever has imported it, or will


def assert_refused(status: int, error: str, said: str = "") -> None:
    """Status 2 and one printable line of at most 300 characters, which says this."""
    assert status == 2 and said in error, (status, error)
    assert_line(error.removesuffix("\n"))


@contextlib.contextmanager
def refused(kind: type[Exception], said: str | None = None):
    """`pytest.raises` of an error that is one line."""
    with pytest.raises(kind, match=said) as caught:
        yield caught
    assert_line(str(caught.value))


def assert_line(text: str) -> None:
    assert 0 < len(text) <= MOST, text
    assert text.isprintable(), repr(text)
    assert "[Errno" not in text, text


def write_scene(scene: Scene, path: Path) -> Path:
    """Write a scene as a YAML file."""
    path.write_text(yaml.safe_dump(scene_to_mapping(scene)), encoding="utf-8")
    return path

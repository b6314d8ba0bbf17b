"""The result folder of a run: whose run it holds, and what it says before the first row is measured."""

from __future__ import annotations

import json
import platform
from pathlib import Path
from typing import Any

from ...core.scene import Scene, SceneError, scene_to_mapping

__all__ = ["SCHEMA", "ResultFolder", "flatten", "read_report", "versions"]

SCHEMA = 1


def versions(with_network: bool) -> dict[str, str]:
    """Versions of what a result depends on; onnxruntime only where a network runs."""
    import numpy
    import scipy

    from ... import __version__

    out = {"radalt": __version__, "python": platform.python_version()}
    out |= {"numpy": numpy.__version__, "scipy": scipy.__version__}
    try:
        from gnuradio import gr
    except ImportError:  # pooling reports of others needs no GNU Radio
        pass
    else:
        out["gnuradio"] = gr.version()
    if with_network:
        import onnxruntime

        out["onnxruntime"] = onnxruntime.__version__
    return out


def flatten(value: Any, prefix: str = "") -> dict[str, Any]:
    """Nested mappings as one, keys joined by dots; lists are values."""
    if not isinstance(value, dict) or not value:
        return {prefix: value}
    out: dict[str, Any] = {}
    for key, item in value.items():
        out |= flatten(item, f"{prefix}.{key}" if prefix else str(key))
    return out


def read_report(path: Path) -> dict[str, Any]:
    """``report.json`` of a result folder.

    Raises
    ------
    SceneError
        One line: what is missing or cannot be read.
    """
    file = path / "report.json"
    try:
        report = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "not valid JSON"
        raise SceneError(f"{file}: cannot be read ({reason}); name the folder of a finished run") from None
    if not isinstance(report, dict) or "schema" not in report:
        raise SceneError(f"{file}: not a report of ota_eval (no 'schema')")
    return report


class ResultFolder:
    """A folder that belongs to one run.

    Parameters
    ----------
    path : Path
        Made if it is not there.
    scene : Scene
        As used: with everything the command line changed.
    methods : dict
        What is known of each method, model hashes among it.
    resume : bool
        Whether the folder may hold a part of this very run.

    Raises
    ------
    SceneError
        If it holds a run and ``resume`` is off, or another run than this one; names the first difference.
    """

    def __init__(
        self,
        path: Path,
        scene: Scene,
        methods: dict[str, dict[str, Any]],
        *,
        resume: bool,
        source: str = "simulated",
    ) -> None:
        self.path, self.scene = path, scene
        self.head: dict[str, Any] = {
            "schema": SCHEMA,
            "kind": "run",
            "complete": False,
            "source": source,
            "name": scene.name,
            "seed": scene.seed,
            "scene": scene_to_mapping(scene),
            "methods": methods,
        }
        if (path / "report.json").exists() or (path / "rows.csv").exists():
            self._check(resume)
        elif path.exists() and not path.is_dir():
            raise SceneError(f"--out {path} is a file; name a folder")
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise SceneError(f"--out {path} cannot be made ({error.strerror}); name another folder") from None

    def _check(self, resume: bool) -> None:
        if not resume:
            raise SceneError(
                f"{self.path} holds a run already; add --resume to complete it, or name another --out"
            )
        held = read_report(self.path)
        # as JSON gives it back, so that 1 and 1.0 or a tuple and a list are no difference
        mine = flatten(
            json.loads(json.dumps({k: self.head[k] for k in ("schema", "source", "scene", "methods")}))
        )
        have = flatten({k: held.get(k) for k in ("schema", "source", "scene", "methods")})
        for key in [*mine, *(k for k in have if k not in mine)]:
            if mine.get(key) != have.get(key):
                raise SceneError(
                    f"{self.path} holds another run: {key} is {have.get(key)!r} there and {mine.get(key)!r} here; "
                    "repeat that run's options, or name another --out"
                )

    def begin(self, left_out: list[str]) -> None:
        """Write the scene and the head of the report, before the first row."""
        import yaml

        if (self.path / "report.json").exists():
            left_out = read_report(self.path).get("left_out", left_out)
        self.head |= {"left_out": left_out, "versions": versions("tcae" in self.scene.methods)}
        text = "# the scene as used, with all defaults and what the command line changed\n"
        text += yaml.safe_dump(self.head["scene"], sort_keys=False)
        (self.path / "scene.yaml").write_text(text, encoding="utf-8")
        self.write(self.head | {"rows": []})

    def write(self, report: dict[str, Any]) -> None:
        """Replace ``report.json`` in one step."""
        fresh = self.path / "report.tmp"
        fresh.write_text(json.dumps(report, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        fresh.replace(self.path / "report.json")

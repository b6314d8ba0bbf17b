"""Options of a user's own methods: networks and method files as rows of their own."""

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .options import Parser, path


def add_own(parser: Parser) -> None:
    """``--model`` and ``--method-file``."""
    add = parser.add_argument
    add(
        "--model",
        action="append",
        metavar="[NAME=]FILE.onnx",
        help="a network as a row NAME; without NAME= it replaces the network of the method tcae; a network in two "
        "files is ENCODER.onnx+DECODER.onnx; repeatable",
    )
    add(
        "--method-file",
        action="append",
        metavar="[NAME=]FILE.py",
        help="your method, mitigate(frames, waveform), as a row NAME, default custom; repeatable",
    )


def own_methods(args: argparse.Namespace) -> dict[str, dict[str, str]]:
    """Method options by --model and --method-file; raises SceneError."""
    from ...core.mitigation.onnx_network import network_files
    from ...core.scene import SceneError

    out: dict[str, dict[str, str]] = {}
    for option, kind, key, given in (
        ("--model", "tcae", "model", args.model),
        ("--method-file", "custom", "file", args.method_file),
    ):
        for text in given or ():
            name, _, file = text.rpartition("=") if not Path(text).exists() else ("", "", text)
            name, own = name or kind, {} if not name else {"method": kind}
            try:
                found = "+".join(str(path(str(part)).resolve()) for part in network_files(path(file)))
            except argparse.ArgumentTypeError as error:
                raise SceneError(f"{option} {text[:60]!r}: {error}") from None
            if name in out:
                raise SceneError(
                    f"{option} {text[:60]!r}: {name} is there already; give each a name, NAME=FILE"
                )
            out[name] = {**own, key: found}
    return out


def option_files(options: Mapping[str, Mapping[str, Any]]) -> dict[str, Path]:
    """Models and method files in options by method, named by method and key; a network's decoder as ``model+``."""
    from ...core.mitigation.onnx_network import network_files

    return {
        f"{method} {key}{k * '+'}": path
        for method, given in options.items()
        for key in ("model", "file")
        for k, path in enumerate(network_files(given[key]) if given.get(key) else ())
    }


def with_option_files(
    given: Mapping[str, Mapping[str, Any] | None], files: Mapping[str, Path]
) -> dict[str, dict[str, Any]]:
    """Options with the files of `option_files` at other paths; files of other names are left alone."""
    out = {name: dict(options or {}) for name, options in given.items()}
    for name, file in files.items():
        method, _, key = name.rpartition(" ")
        if key.rstrip("+") not in ("model", "file"):
            continue
        options = out.setdefault(method, {})
        decoder = key.endswith("+")  # follows its encoder
        options[key.rstrip("+")] = f"{options['model']}+{file}" if decoder else str(file)
    return out

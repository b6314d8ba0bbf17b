"""Options of a user's own methods: networks and method files as rows of their own."""

import argparse
from pathlib import Path

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

#!/usr/bin/env python3
"""Manual pages and bash completion of the command `radalt`, made from the parsers of its programs.

    .venv/bin/python tools/make_man.py build

Writes build/man1/radalt*.1 and build/completion/radalt. CMake runs it; NumPy, SciPy, PyYAML and pyzmq are needed.
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "python"))

from radalt import __version__  # noqa: E402 - the path first
from radalt.core.mitigation import METHODS  # noqa: E402
from radalt.evaluation import programs  # noqa: E402

SCENES = "$(cd {share}/flowgraphs/scenes 2>/dev/null && ls *.yaml | sed s/.yaml$//)"


def escaped(text: str) -> str:
    """Text escaped for roff."""
    text = text.replace("\\", "\\e").replace("-", "\\-")
    return "\n".join(f"\\&{line}" if line.startswith((".", "'")) else line for line in text.splitlines())


def _usage(action: argparse.Action) -> str:
    """An option or argument as typed."""
    value = action.metavar or ("{" + ",".join(map(str, action.choices)) + "}" if action.choices else None)
    if not action.option_strings:
        return value or action.dest
    names = ", ".join(action.option_strings)
    return names if action.nargs == 0 else f"{names} {value or action.dest.upper()}"


def _help(parser: argparse.ArgumentParser, action: argparse.Action) -> str:
    return parser._get_formatter()._expand_help(action) if action.help else ""


def page(name: str, parser: argparse.ArgumentParser) -> str:
    """One manual page."""
    details = parser.epilog or ""
    examples = [line.strip() for line in details.splitlines() if line.strip().startswith("radalt ")]
    prose = "\n".join(line for line in details.splitlines() if not line.strip().startswith("radalt "))
    lines = [
        f'.TH RADALT\\-{escaped(name).upper()} 1 "" "gr\\-radalt {__version__}"',
        ".SH NAME",
        f"radalt\\-{escaped(name)} \\- {escaped(parser.description.rstrip('.'))}",
        ".SH SYNOPSIS",
        f".B radalt {escaped(name)}\n[options]",
        ".SH DESCRIPTION",
        re.sub(r"\n\s*\n", "\n.PP\n", escaped(re.sub(r"\n +", "\n", prose.strip()))) or ".PP",
        ".SH OPTIONS",
    ]
    for action in parser._actions:
        lines += [".TP", f".B {escaped(_usage(action))}", escaped(_help(parser, action)) or "\\&"]
    if examples:
        lines += [".SH EXAMPLES", ".nf", *(escaped(line) for line in examples), ".fi"]
    lines += [
        ".SH EXIT STATUS",
        "0 done, 2 after one line about an error, 130 after Ctrl\\-C, 143 after SIGTERM.",
    ]
    lines += [".SH SEE ALSO", ".BR radalt (1)"]
    return "\n".join(lines) + "\n"


def overview() -> str:
    """The page of `radalt` itself."""
    lines = [
        f'.TH RADALT 1 "" "gr\\-radalt {__version__}"',
        ".SH NAME",
        "radalt \\- FMCW radar altimeters under interference, in GNU Radio",
        ".SH SYNOPSIS",
        ".B radalt\n.I command\n[options]",
        ".SH COMMANDS",
    ]
    for name, text in programs.summaries().items():
        lines += [".TP", f".BR radalt\\-{escaped(name)} (1)", escaped(text)]
    lines += [".TP", ".B radalt env", 'Shell lines for an unusual prefix: eval "$(radalt env)"']
    lines += [
        ".SH ENVIRONMENT",
        ".TP",
        ".B RADALT_PLUGINS",
        "Python modules with methods or interferers of your own.",
    ]
    lines += [".TP", ".B RADALT_TRACEBACK", "Set: errors keep their Python traceback."]
    return "\n".join(lines) + "\n"


def completion(parsers: dict[str, argparse.ArgumentParser], share: str) -> str:
    """A script for bash: commands, their options, choices, scenes and methods."""
    cases, choices = [], {}
    for name, parser in parsers.items():
        options = [o for action in parser._actions for o in action.option_strings if o.startswith("--")]
        words = [c for a in parser._actions if a.choices and not a.option_strings for c in a.choices]
        cases.append(f"        {name}) words='{' '.join([*options, *words])}' ;;")
        for action in parser._actions:
            if action.choices:
                choices |= {f"{name} {option}": action.choices for option in action.option_strings}
    values = [f'        "{key}") words="{" ".join(map(str, given))}" ;;' for key, given in choices.items()]
    return f"""# bash completion of radalt; made by tools/make_man.py from the programs' parsers
_radalt() {{
    local words='' now=${{COMP_WORDS[COMP_CWORD]}} before=${{COMP_WORDS[COMP_CWORD-1]}} command=${{COMP_WORDS[1]}}
    COMPREPLY=()
    if [ "$COMP_CWORD" -eq 1 ]; then
        COMPREPLY=($(compgen -W '{" ".join(parsers)} env --help --version' -- "$now"))
        return
    fi
    case "$command $before" in
{chr(10).join(values)}
        *" --scene") words="{SCENES.format(share=share)}" ;;
        *" --methods") words='{" ".join(METHODS)}' ;;
    esac
    if [ -n "$words" ]; then
        COMPREPLY=($(compgen -W "$words" -- "$now") $(compgen -f -- "$now"))
        return
    fi
    case "$command" in
{chr(10).join(cases)}
    esac
    case "$now" in
        -*) COMPREPLY=($(compgen -W "$words" -- "$now")) ;;
        *) COMPREPLY=($(compgen -W "${{words//--[a-z-]*/}}" -- "$now") $(compgen -f -- "$now")) ;;
    esac
}}
complete -o filenames -F _radalt radalt
"""


def main() -> int:
    """Write all pages and the completion."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, help="folder")
    parser.add_argument("--share", default=str(ROOT), help="where flowgraphs/ will lie (default: here)")
    args = parser.parse_args()
    parsers = {name: programs.load(name)._parser() for name in programs.programs()}
    for folder in ("man1", "completion"):
        (args.out / folder).mkdir(parents=True, exist_ok=True)
    (args.out / "man1/radalt.1").write_text(overview(), encoding="utf-8")
    for name, its in parsers.items():
        text = page(name, its).replace(escaped(str(ROOT)), escaped(args.share))
        (args.out / f"man1/radalt-{name}.1").write_text(text, encoding="utf-8")
    (args.out / "completion/radalt").write_text(completion(parsers, args.share), encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

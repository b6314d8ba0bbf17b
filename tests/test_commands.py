"""Every command that a page or a help text prints can be typed as it stands: interpreter, file and options exist."""

import argparse
import importlib
import os
import re
import runpy
import shlex
import shutil
import sys
from pathlib import Path

import ota_eval
import pytest
from waiting import ROOT, ran, ran_python

from radalt.evaluation.commands import make_recording
from radalt.evaluation.programs import main, programs

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *ROOT.glob("docs/*.md"), *ROOT.glob("models/*.md")]
PROGRAMS = sorted(p for p in ROOT.glob("flowgraphs/*.py") if not p.name.startswith("_"))
# A method that programs read, and commands until 0.3.0, which name their list whatever follows (a test below)
WITHOUT_HELP = ("own_method", "cancellation", "detection", "error_vs_runtime")
FOLDERS = ("training", "tools", "packaging", "examples", "tests")
COMMANDS = sorted(program.file for program in programs().values())
SOURCES = [*PROGRAMS, *COMMANDS, *(file for folder in FOLDERS for file in ROOT.glob(f"{folder}/*.py"))]
COMMAND = re.compile(
    r"(?:[A-Z_]+=\S+ )*(?:\S*bin/(?:python3?|radalt)|python3?|make|\./\S+|tools/\S+\.sh) \S.*"
)
# Those that stop by themselves before they measure; of all others only the options are read.
STOP = dict.fromkeys(("integrity", "landing_eval", "leaving_out", "stability"), "--dry-run")
STOP["ota_eval"] = "--plan"
PLACEHOLDER = re.compile(r"\b(CASE|NAME|LOGIN-NODE)\b|\.\.\.|/path/to/")


def commands(file: Path) -> list[str]:
    """Lines of code blocks and pieces of inline code that are commands."""
    text = file.read_text(encoding="utf-8")
    if file.suffix == ".py":
        lines = (text.split('"""') + [""])[1].splitlines()
    else:
        lines = [line for line in text.splitlines() if line.startswith("    ")]
        for language, fence in re.findall(r"^```(\w*)\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
            lines += fence.splitlines() if language in ("", "sh", "bash", "console") else []
    found = [line.strip() for line in lines if COMMAND.fullmatch(line.strip())]
    return found + [code for code in re.findall(r"`([^`\n]+)`", text) if COMMAND.fullmatch(code)]


def printed() -> dict[str, list[str]]:
    """Command -> the files that print it."""
    found: dict[str, list[str]] = {}
    for file in [*PAGES, *SOURCES]:
        for line in commands(file):
            found.setdefault(re.sub(r" +(#.*|&)$", "", line), []).append(file.name)
    return found


PRINTED = printed()
TYPED = {line: shlex.split(line) for line in PRINTED}


class Accepted(BaseException):
    """The options were read; what would follow is not wanted."""


@pytest.fixture
def options_alone(monkeypatch):
    """Every program ends when its options have been read without complaint."""
    parse = argparse.ArgumentParser.parse_args

    def parse_args(self, *args, **kwargs):
        parse(self, *args, **kwargs)
        raise Accepted

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", parse_args)


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    """A folder like the source tree, with the files that pages call the reader's own."""
    folder = tmp_path_factory.mktemp("desk")
    for name in "flowgraphs models training tools python docs examples packaging .venv".split():
        (folder / name).symlink_to(ROOT / name)
    landing = ROOT / "flowgraphs/landing"
    (folder / "variants").mkdir()
    kinds = "tcae_int8", "tcae_float16", "tcae_int8-dynamic"
    variants = [f"{where}{kind}" for where in ("", "variants/") for kind in kinds]
    for name in ("my", "mynet", "encoder", "decoder", *variants):
        shutil.copy(ROOT / "models/tcae.onnx", folder / f"{name}.onnx")
    for name, like in {
        "flight.csv": landing / "approach_kord_10c.csv",
        "n41.dt1": landing / "hilly_n41w088.dt0",
        "n42.dt1": landing / "hilly_n41w089.dt0",
        "mymethod.py": ROOT / "flowgraphs/own_method.py",
        "my_altimeter.yaml": ROOT / "flowgraphs/altimeters/fmcw_150mhz.yaml",
    }.items():
        shutil.copy(like, folder / name)
    for model in (ROOT / "models").glob("*.onnx"):
        shutil.copy(model, folder)
    study = (landing / "study.yaml").read_text()
    (folder / "my_study.yaml").write_text(study.replace("../", f"{ROOT / 'flowgraphs'}/"))
    for file in landing.iterdir():  # what the study names is next to it
        if file.name != "study.yaml":
            shutil.copy(file, folder)
    make_recording.main(["--out", str(folder / "results" / "recorded.sigmf-meta")])
    make_recording.main(["--from", "dvbt", "--out", str(folder / "results" / "dvbt.sigmf-meta")])
    (folder / "my.yaml").write_text("name: my\n")
    reference = (ROOT / "docs/scene-reference.md").read_text(encoding="utf-8")
    (folder / "my_case.yaml").write_text(re.search(r"```yaml\n(.*?)```", reference, re.DOTALL)[1])
    radio = "{radar_serial: 30AAAAA, jammer_serial: 30BBBBB, enclosure: cabled, attenuation_db: 60}"
    (folder / "my_bench.yaml").write_text(f"radio: {radio}\n")
    return folder


def words(line: str) -> tuple[dict[str, str], list[str]]:
    """Variables before a command, and the command; one of ``.venv/bin/radalt`` as that of its program."""
    typed = list(TYPED[line])
    if typed[0] == ".venv/bin/radalt":
        typed[:2] = [".venv/bin/python", f"flowgraphs/{programs()[typed[1]].script}.py"]
    variables = {}
    while re.match(r"[A-Z_]+=", typed[0]):
        name, _, value = typed.pop(0).partition("=")
        variables[name] = value
    spread = (sorted(map(str, Path().glob(w))) if "*" in w else [w] for w in typed)  # as a shell does
    return variables, [word for words in spread for word in words]


def of(*kinds: str) -> list[str]:
    """Commands without placeholders whose first word, and the start of whose second, are these."""
    typed = {line: words(line)[1] for line in PRINTED if not PLACEHOLDER.search(line)}
    found = [line for line in typed if typed[line][0] == kinds[0]]
    return [line for line in found if len(kinds) == 1 or typed[line][1].startswith(kinds[1:])]


def test_one_form_that_debian_knows():
    """Debian has no `python`, and its python3 has not what the environment has."""
    forms = (".venv/bin/python", ".venv-train/bin/python", "make", "tools/", "./")
    assert {line: files for line, files in PRINTED.items() if not words(line)[1][0].startswith(forms)} == {}


@pytest.mark.parametrize("line", of(".venv/bin/python", "flowgraphs/"))
def test_line_of_a_program_is_accepted(line, request, desk, monkeypatch, capsys):
    monkeypatch.chdir(desk)
    _, (_, script, *arguments) = words(line)
    assert Path(script).is_file()
    program = Path(script).stem
    monkeypatch.syspath_prepend(str(ROOT / "flowgraphs"))
    stop = STOP.get(program)
    # recordings and clusters are other tests' business, and plugins those of test_extending; models load slowly
    others = {"--replay", "--scheduler"} & set(arguments) or "clipper" in line or program == "stability"
    if stop and not others:
        ends = "--check" in arguments or stop in arguments
        options = arguments if ends else [*arguments, stop]
        # nothing to go on with, and no radio
        options = [o for o in options if o not in ("--resume", "--calibrate")]
        status = importlib.import_module(program).main(options)
        assert (status, capsys.readouterr().err) == (0, "")
        return
    request.getfixturevalue("options_alone")
    with pytest.raises(Accepted):
        importlib.import_module(program).main(arguments)


@pytest.mark.parametrize("line", of(".venv/bin/python", "training/", "tools/", "packaging/"))
def test_options_of_a_tool_are_accepted(line, options_alone, monkeypatch):
    monkeypatch.chdir(ROOT)
    variables, (_, script, *arguments) = words(line)
    monkeypatch.setattr(sys, "argv", [script, *arguments])
    paths = [str(ROOT / p) for p in variables.get("PYTHONPATH", "").split(os.pathsep) if p]
    monkeypatch.setattr(sys, "path", [str((ROOT / script).parent), *paths, *sys.path])
    with pytest.raises(Accepted):
        runpy.run_path(script, run_name="__main__")


@pytest.mark.parametrize("line", of(".venv-train/bin/python"))
def test_options_of_training_are_in_its_source(line):
    """It needs PyTorch, which is not in the environment of the tests."""
    _, (_, script, *arguments) = words(line)
    source = (ROOT / script).read_text(encoding="utf-8")
    for option in (a.partition("=")[0] for a in arguments if a.startswith("--")):
        assert f'"{option}"' in source


@pytest.mark.parametrize("line", of("make"))
def test_make_knows_its_targets(line):
    ran("make", "-n", *words(line)[1][1:], cwd=ROOT, check=True)


@pytest.mark.parametrize("line", of(".venv/bin/python", "-m"))
def test_modules_that_are_run_are_there(line):
    assert importlib.util.find_spec(words(line)[1][2]) is not None


def test_a_shell_runs_the_first_line_of_the_readme(desk):
    line = next(line for line in PRINTED if "README.md" in PRINTED[line] and "radalt eval" in line)
    # `make test` makes it, ctest with the system's Python does not
    if not (ROOT / ".venv/bin/radalt").exists():
        pytest.skip("no .venv/bin/radalt here: the module is tested where `make setup` was not run")
    assert "built" in ran("sh", "-c", f"{line} --plan", cwd=desk, check=True).stdout


def test_a_training_program_says_where_it_lies(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [str(ROOT / "training/cards.py"), "--help"])
    with pytest.raises(SystemExit):
        runpy.run_path(sys.argv[0], run_name="__main__")
    assert capsys.readouterr().out.startswith("usage: PYTHONPATH=python .venv/bin/python training/cards.py")


HELPFUL = [p for p in PROGRAMS if p.stem not in WITHOUT_HELP]
HELPFUL += sorted([*ROOT.glob("tools/[!_]*.*"), *ROOT.glob("cmake/*.py")])


@pytest.mark.parametrize("program", HELPFUL, ids=lambda p: p.name)
def test_help_acts_on_nothing(program, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    if program.suffix == ".py":
        monkeypatch.setattr(sys, "argv", [str(program), "--help"])
        monkeypatch.setattr(sys, "path", [str(program.parent), *sys.path])
        for name in ("write_text", "write_bytes", "mkdir"):
            monkeypatch.setattr(Path, name, lambda *a, **k: pytest.fail("touched a file"))
        with pytest.raises(SystemExit) as ended:
            runpy.run_path(str(program), run_name="__main__")
        assert ended.value.code in (0, None)
    else:
        print(ran("sh", program, "--help", check=True).stdout)
    assert "usage" in capfd.readouterr().out.lower()
    assert not list(tmp_path.iterdir())


def test_a_reader_that_closes_the_pipe_ends_a_command_in_silence():
    script = f"({sys.executable} {ROOT}/flowgraphs/ota_eval.py --plan; echo $? >&2) | true"
    assert ran("sh", "-c", script).stderr == "141\n"


@pytest.mark.parametrize("word", ["cancellation", "detection", "error-vs-runtime"])
def test_a_former_command_names_its_list(word, capsys):
    assert main([word, "--frames=3"]) == 2
    said = capsys.readouterr().err
    named = re.findall(r"radalt bench (\w+)", said)
    assert named and said.count("\n") == 1 and all((ROOT / f"bench/{name}.yaml").is_file() for name in named)
    script = ran_python(ROOT / f"flowgraphs/{word.replace('-', '_')}.py")
    assert (script.returncode, script.stderr) == (2, said)


def test_a_command_that_is_nearly_one_is_named(capsys):
    assert main(["evla"]) == 2
    line = "radalt: no command 'evla'; did you mean 'eval'? allowed: eval, "
    assert capsys.readouterr().err.startswith(line)


@pytest.mark.parametrize(("called", "name"), [("radalt eval", "radalt eval"), ("ota_eval.py", "ota_eval")])
def test_an_option_that_is_nearly_one_is_named(capsys, monkeypatch, called, name):
    monkeypatch.setattr(sys, "argv", [called])
    for wrong, near in (("--ovrlap=1", "did you mean '--overlap'. "), ("--cases", "")):
        with pytest.raises(SystemExit):
            ota_eval.main(["--sim", wrong])
        assert re.match(f"{name}: .* {wrong}; {near}--help lists the options", capsys.readouterr().err)

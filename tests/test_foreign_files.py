"""Files, names and users that nobody meant: weights outside a network, links in a result folder, a name of signs."""

import base64
import os
import sys

import gallery
import numpy as np
import pytest
from hostile import assert_refused, ended
from waiting import ran_python

from radalt.core.mitigation import MitigationError, create
from radalt.core.parsing import InputError
from radalt.core.returns.terrain import Terrain
from radalt.core.sigmf_file import open_sigmf
from radalt.core.waveform import Waveform
from radalt.evaluation.commands import make_recording
from radalt.evaluation.results.figure import new_figure, save_figure
from radalt.evaluation.results.folder import FolderError, RunFolder, write_json

# an ONNX file of one matrix product, whose matrix lies in the file m.data next to it
WEIGHTS_OUTSIDE = base64.b64decode(
    b"CAg6fAoRCgF4CgF3EgF5IgZNYXRNdWwSAWcqOggECAQQAUIBd2oSCghsb2NhdGlvbhIGbS5kYXRhagsKBm9mZnNldBIBMGoM"
    b"CgZsZW5ndGgSAjY0cAFaEwoBeBIOCgwIARIICgIIAQoCCARiEwoBeRIOCgwIARIICgIIAQoCCARCBAoAEBE="
)
RUN = "--sim --overlap 0 --altitudes 100 --frames 2 --methods none --jobs 1 --out".split()


def run(root, *arguments, **environment):
    return ran_python(root / "flowgraphs/ota_eval.py", *arguments, env=os.environ | environment)


def test_a_network_whose_weights_lie_outside_its_file_is_refused(tmp_path, monkeypatch):
    """No digest would cover them: they could be changed between a kill and --resume."""
    (tmp_path / "m.onnx").write_bytes(WEIGHTS_OUTSIDE)
    (tmp_path / "m.data").write_bytes(np.ones(16, np.float32).tobytes())
    monkeypatch.chdir(tmp_path)
    with pytest.raises(MitigationError, match="keeps weights outside its file"):
        create("tcae", Waveform(), model=tmp_path / "m.onnx")


def test_a_result_folder_is_never_written_through_a_link(tmp_path):
    mine = tmp_path / "mine.txt"
    mine.write_text("mine")
    folder = tmp_path / "run"
    RunFolder(folder, {"study": "one"}).close()
    for name in ("rows.csv.tmp", "report.md", "figures"):
        (folder / name).symlink_to(mine)
        with pytest.raises(FolderError, match=f"{name} is a link"):
            RunFolder(folder, {"study": "one"}, resume=True)
        (folder / name).unlink()
    (folder / "rows.json.tmp").symlink_to(mine)  # put there while the run goes on
    write_json(folder / "rows.json", {})
    assert mine.read_text() == "mine"


def test_a_name_that_is_no_mathematics_is_drawn_as_it_is(tmp_path):
    figure = new_figure(3, 2)
    axis = figure.subplots()
    axis.plot([1, 2], [1, 2], label="mine$^{x")
    axis.set_title("a$_{b")
    axis.set_yscale("log")
    axis.set_ylim(1e-3, 1e3)
    axis.legend()
    save_figure(figure, tmp_path / "x.png")
    assert all(label.get_parse_math() for label in axis.get_yticklabels())  # powers of ten are drawn as such
    assert b"/Type3" not in (tmp_path / "x.pdf").read_bytes()  # publishers ask for TrueType


def test_no_terminal_no_home_and_no_style_of_the_user_ends_a_run(root, tmp_path):
    """Encoding, home, the backend of a Jupyter elsewhere, a font and TeX that are not installed."""
    style = tmp_path / "matplotlibrc"
    style.write_text("text.usetex: True\nfont.family: None Such\n")
    theirs = {"MPLBACKEND": "module://matplotlib_inline.backend_inline", "MATPLOTLIBRC": str(style)}
    theirs |= {"PYTHONIOENCODING": "latin-1", "HOME": "/proc/nobody"}
    done = run(root, *RUN, tmp_path / "x$^{\N{MINUS SIGN}y", **theirs)
    assert (done.returncode, done.stderr) == (0, "")
    assert "\\u2212" in done.stdout


@pytest.mark.parametrize(
    ("name", "read"),
    [("sigmf", lambda p: open_sigmf(p / "x.sigmf-meta")), ("dted", lambda p: Terrain.load([p / "x.dt0"]))],
)
def test_an_optional_package_that_is_missing_is_named_with_the_remedy(monkeypatch, tmp_path, name, read):
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(InputError, match=f"the package {name}, which .*python.* lacks; run 'make setup'"):
        read(tmp_path)


def test_a_live_flowgraph_without_a_display_is_one_line(root):
    """Qt would abort."""
    program = "from gnuradio import qtgui; from radalt.evaluation.flowgraph.window import by_hand"
    env = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")}
    done = ran_python("-c", program, env=env | {"PYTHONPATH": str(root / "python")})
    assert done.returncode == 2 and done.stderr.startswith("no display for the window; ")
    assert done.stderr.count("\n") == 1


def test_a_numpy_that_gnu_radio_was_not_built_for_is_one_line(root, tmp_path):
    """NumPy prints 50 lines of its own before the error."""
    (tmp_path / "gnuradio/gr").mkdir(parents=True)
    (tmp_path / "gnuradio/__init__.py").touch()
    (tmp_path / "gnuradio/gr/__init__.py").write_text(
        "import sys\nprint('cannot be run in\\n' * 50, file=sys.stderr)\nraise ImportError('initialization failed')\n"
    )
    done = run(root, *RUN, tmp_path / "out", PYTHONPATH=str(tmp_path))
    assert_refused(done.returncode, done.stderr)
    assert f"was GNU Radio built for NumPy {np.__version__}?" in done.stderr


@pytest.mark.parametrize(
    "module, name", [(gallery, "x.png"), (make_recording, "x.sigmf-meta"), (make_recording, "x.sigmf-data")]
)
def test_what_a_command_has_not_written_is_kept(module, name, tmp_path):
    (tmp_path / name).write_text("mine")
    status, error = ended(module.main, f"--out={tmp_path / name.replace('data', 'meta')}")
    assert_refused(status, error)
    assert f"{name} exists, and this program has not written it; move it away" in error
    assert (tmp_path / name).read_text() == "mine"

"""Publishing a result: stable names, and links that still lead somewhere."""

import pytest

from radalt.evaluation.engine.command import main, publish
from radalt.evaluation.engine.options import Options, Parser, add_options, command_of, options_of
from radalt.evaluation.engine.study import Study


def test_links_between_published_files_follow_their_names(tmp_path):
    result = tmp_path / "run"
    (result / "figures").mkdir(parents=True)
    (result / "figures" / "a.png").write_bytes(b"\x89PNG")
    (result / "rows.csv").write_text("a\n1\n")
    (result / "report.md").write_text("![a](figures/a.png) [rows](rows.csv) [other](tcae.md)")
    names = {"report.md": "pages/a.md", "rows.csv": "data/a.csv", "figures/a.png": "pages/a.png"}
    written = publish(result, names, tmp_path / "docs")
    assert written == [tmp_path / "docs" / name for name in names.values()]
    page = (tmp_path / "docs" / "pages" / "a.md").read_text()
    assert page == "![a](a.png) [rows](../data/a.csv) [other](tcae.md)"
    assert (tmp_path / "docs" / "pages" / "a.png").read_bytes() == b"\x89PNG"
    assert (tmp_path / "docs" / "data" / "a.csv").read_text() == "a\n1\n"
    assert (result / "report.md").read_text().startswith("![a](figures/a.png)")


class Unpublished(Study):
    """A study that the documentation has no page of."""

    def points(self):
        return []


def test_a_study_without_a_page_refuses_to_publish_before_it_measures(tmp_path, capsys):
    options = Options(tmp_path / "run", publish=tmp_path / "docs")
    assert main(Unpublished(), options, program="p", dry_run=False) == 2
    assert "has no page in the documentation" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


class Published(Unpublished):
    """A study with a page."""

    published = {"report.md": "a.md"}


@pytest.mark.parametrize("dry_run", [True, False])
def test_a_folder_that_cannot_take_the_page_is_refused_before_hours_of_measuring(tmp_path, capsys, dry_run):
    (tmp_path / "docs").write_text("a file")
    for target in (tmp_path / "docs", tmp_path / "docs" / "below", tmp_path / "/proc/docs"):
        options = Options(tmp_path / "run", publish=target)
        assert main(Published(), options, program="p", dry_run=dry_run) == 2
        out, err = capsys.readouterr()
        assert out == "" and err.count("\n") == 1 and " cannot be written (No" in err
    assert not (tmp_path / "run").exists()


def test_the_command_in_a_report_holds_what_its_rows_depend_on_and_no_folder(tmp_path):
    parser = Parser("study", "A study.")
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--models", nargs="*", type=type(tmp_path))
    add_options(parser, out="results/study")
    words = ["--frames", "6", "--quick", "--jobs", "1", "--out", str(tmp_path)]
    args = parser.parse_args([*words, "--publish", "docs", "--models", str(tmp_path / "a b.onnx")])
    command = command_of(args, parser)
    assert command == (".venv/bin/python flowgraphs/study.py --frames=6 --quick --models 'a b.onnx'")
    assert options_of(args, parser, command=command).publish.name == "docs"

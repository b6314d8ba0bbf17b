"""The rooms stand in the order of the signal's way: no import points up, and none goes round in a circle."""

import functools
from graphlib import CycleError, TopologicalSorter

import draw_architecture as architecture
import pytest

every = functools.cache(architecture.imports)

# imports within functions that close a circle of modules, and why each may
LAZY_CIRCLES = {
    ("core.mitigation.own_process", "core.mitigation"): "the process next to it builds methods by name",
    ("core.mitigation.trial_run", "core.mitigation"): "the process that tries a file builds methods by name",
}


def circle(imports):
    """Modules of one circle, first and last the same; empty if there is none."""
    after = {}
    for entry in imports:
        after.setdefault(entry.source, set()).add(entry.target)
    try:
        TopologicalSorter(after).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def upward(imports):
    """Imports of a room that stands after the importing one, within functions too."""
    place, between = architecture.ROOMS.index, architecture.between_rooms(imports)
    return [entry for (one, other), found in between.items() if place(one) < place(other) for entry in found]


def test_no_import_points_up():
    assert upward(every()) == []


def test_only_the_methods_that_judge_their_own_output_know_an_altimeter():
    """`lms` and `shift_check`; others know its settings and the quality of received frames, and no more."""
    asking = {(e.source, e.target) for e in every() if e.source.startswith("core.mitigation")}
    asking = {(s, t) for s, t in asking if t.startswith(("core.altimeter", "core.timing", "core.tracker"))}
    altimeter = "core.altimeter.altimeter"
    known = {"core.altimeter.altimeter_settings", "core.altimeter.frame_quality"}
    assert {s for s, t in asking if t not in known} == {"core.mitigation.lms", "core.mitigation.shift_check"}
    assert {target for _, target in asking} <= {altimeter} | known


def test_no_import_goes_round_when_modules_are_loaded_nor_one_within_a_function_of_the_bench_or_a_study():
    """A study names its report within `report`, and the report has its names from a third file."""
    above = ("evaluation", "studies", "api")
    assert circle([entry for entry in every() if not entry.lazy]) == []
    assert circle([entry for entry in every() if entry.source.startswith(above)]) == []


def test_imports_within_functions_close_no_circle_in_core_but_those_with_a_reason():
    core = [entry for entry in every() if entry.source.startswith("core")]
    known = {(entry.source, entry.target) for entry in core if entry.lazy}
    assert known >= LAZY_CIRCLES.keys(), "an exception that is no longer needed"
    assert circle(core) != []
    assert circle([entry for entry in core if (entry.source, entry.target) not in LAZY_CIRCLES]) == []


def test_nothing_imports_a_study_and_no_study_another():
    for entry in every():
        if entry.target.startswith("studies."):
            assert entry.source.split(".")[:2] == entry.target.split(".")[:2], entry


def test_every_module_has_its_room():
    homeless = [m for m in architecture.modules(architecture.PACKAGE) if architecture.room_of(m) is None]
    assert homeless == ["", "__main__"]  # the package itself, and as a command
    assert len(every()) > 300  # and the reader has read them


@pytest.mark.parametrize(
    ("line", "lazy"),
    [
        ("from ..scene import thing", False),
        ("from ..scene.thing import name", False),
        ("def f():\n    from .. import scene", True),
        ("import radalt.core.scene", False),
        ("from radalt.core.scene import thing", False),
        ("if True:\n    from ..scene import thing", False),
        ("class C:\n  def f(self):\n    async def g():\n      import radalt.core.scene.thing", True),
    ],
)
def test_an_arrow_up_is_found_however_it_is_written(tmp_path, line, lazy):
    package = tmp_path / "radalt"
    for room in ("core/altimeter", "core/scene", "core", ""):
        (package / room).mkdir(parents=True, exist_ok=True)
        (package / room / "__init__.py").write_text("")
    (package / "core/scene/thing.py").write_text("from ..altimeter import cfar\n")
    (package / "core/altimeter/cfar.py").write_text(line + "\n")
    found = architecture.imports(package)
    (wrong,) = upward(found)
    assert (wrong.source, wrong.lazy) == ("core.altimeter.cfar", lazy)
    if wrong.target.endswith("thing"):
        assert set(circle(found)) == {"core.altimeter.cfar", "core.scene.thing"}
    with pytest.raises(ValueError, match=r"core\.altimeter imports core\.scene"):
        architecture.draw(package)


def test_the_figure_is_what_the_code_gives():
    drawn = architecture.FIGURE.read_text(encoding="utf-8")
    assert drawn == architecture.draw(), "run: .venv/bin/python tools/draw_architecture.py"

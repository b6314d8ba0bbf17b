"""`radalt` and `gnuradio.radalt` are one package in the source tree; test_install.py asks it of an installation."""

from waiting import ran_python

ONE_PACKAGE = """
import sys
{first}
{second}
import radalt.core.mitigation.base
import gnuradio.radalt.core.scene.scene as other
from gnuradio.radalt.core.scene import Scene
from radalt.core.scene import Scene as canonical
from gnuradio import radalt as root
assert root is sys.modules["radalt"] is sys.modules["gnuradio.radalt"]
assert Scene is canonical and other is sys.modules["radalt.core.scene.scene"], Scene
twice = [name for name, module in sys.modules.items() if getattr(module, "__file__", None)
         and "radalt" in name and module.__name__ != name.removeprefix("gnuradio.")]
assert not twice, twice
specs = [name for name, module in sys.modules.items() if name.startswith("radalt") and module.__spec__.name != name]
assert not specs, specs
from radalt.core.mitigation import METHODS, register, Mitigation
@register
class Mine(Mitigation):
    name = "mine"
    def _clean(self, batch):
        return batch
from gnuradio.radalt.core.mitigation import METHODS as known
assert "mine" in known
"""


def test_both_names_give_the_same_modules_whichever_comes_first(root):
    names = "import radalt", "import gnuradio.radalt"
    for first, second in (names, names[::-1]):
        code = ONE_PACKAGE.format(first=first, second=second)
        ran_python("-W", "error", "-c", code, cwd=root / "python", limit_s=60, check=True)

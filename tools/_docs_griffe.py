"""Griffe's extension: parameters that share an entry of a docstring get one each, with the default of each."""

from __future__ import annotations

import re
from typing import Any

import griffe

_SHARED = re.compile(r"^(\w+(?:, \w+)+)((?: : .*)?(?:\n .*)+)$", re.MULTILINE)


class OneEntryEach(griffe.Extension):
    """Take "a, b : float" and "a, b" for two entries of the same words."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        if obj.docstring:
            obj.docstring.value = _SHARED.sub(
                lambda found: "\n".join(f"{name}{found[2]}" for name in found[1].split(", ")),
                obj.docstring.value,
            )

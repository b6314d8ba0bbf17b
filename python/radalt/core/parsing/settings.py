"""Settings that declare themselves once: a dataclass field has its unit in the name, its limits and words in `setting`.

What a field means is the string below it. Checks, the scene reference and the API pages are made from these.
"""

import dataclasses
from collections.abc import Collection
from typing import Any, ClassVar

from .messages import check_range


def setting(default: Any, *limits: float, among: Collection = ()) -> Any:
    """A dataclass field within limits as of `check_range`, or one of the words ``among``; None as a value passes."""
    return dataclasses.field(default=default, metadata={"limits": limits, "among": tuple(among)})


class Settings:
    """Base of a dataclass of `setting` fields, checked when it is made; ``where`` is their section in messages.

    Raises `ValueError`: one line with section, field, value and what is allowed.
    """

    section: ClassVar[str] = ""

    def __init_subclass__(cls, where: str = "", **others: Any) -> None:
        super().__init_subclass__(**others)
        cls.section = where or vars(cls).get("scene_name") or cls.section

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            value, among = getattr(self, field.name, None), field.metadata.get("among")
            if among and value not in among:
                raise ValueError(f"{self.section}.{field.name} is {value!r}; allowed: {', '.join(among)}")
            if field.type is int and isinstance(value, float) and not value.is_integer():
                raise ValueError(f"{self.section}.{field.name} is {value:g}; expected a whole number")
            if isinstance(field.default, bool) and value not in (True, False):
                raise ValueError(f"{self.section}.{field.name} is {value!r}; expected true or false")
            if field.metadata.get("limits"):
                if value is None and "None" not in str(field.type):
                    raise ValueError(f"{self.section}.{field.name} is None; expected a number")
                check_range(self.section, self, **{field.name: field.metadata["limits"]})

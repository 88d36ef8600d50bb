"""The base class of the models of all files."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

if TYPE_CHECKING:
    from pydantic_core import InitErrorDetails

__all__ = ["Strict"]


class Strict(BaseModel):
    """Base class of the models of all files: immutable, only finite numbers, which are no booleans, no unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _no_boolean(cls, value: object, info: ValidationInfo) -> object:
        # pydantic reads true as the number 1
        if not _only_numbers(cls, info.field_name or ""):
            return value
        places = list(_booleans(value))
        if not places:
            return value
        kind = PydanticCustomError("number", "must be a number; write it in digits")
        wrong: list[InitErrorDetails] = [{"type": kind, "loc": place, "input": inner} for place, inner in places]
        raise ValidationError.from_exception_data(cls.__name__, wrong)


_DEEPEST = 4  # levels of lists and tables in one field


def _booleans(value: object, place: tuple[int | str, ...] = ()) -> Iterator[tuple[tuple[int | str, ...], bool]]:
    if isinstance(value, bool):
        yield place, value
    elif len(place) == _DEEPEST:
        return
    elif isinstance(value, list | tuple):
        for k, inner in enumerate(value):
            yield from _booleans(inner, (*place, k))
    elif isinstance(value, dict):
        for name, inner in value.items():
            yield from _booleans(inner, (*place, name))


@cache
def _only_numbers(model: type[BaseModel], name: str) -> bool:
    """Return whether a field accepts numbers, but neither booleans nor models, which look after their own fields."""
    field = model.model_fields.get(name)
    if field is None:
        return False
    annotation: Any = field.annotation
    parts = {annotation, *_parts(annotation)}
    if any(isinstance(part, type) and issubclass(part, BaseModel) for part in parts):
        return False
    return bool(parts & {float, int}) and not parts & {bool, object, Any}


def _parts(annotation: Any) -> Iterator[Any]:
    if get_origin(annotation) is Literal:
        return
    for inner in get_args(annotation):
        yield inner
        yield from _parts(inner)

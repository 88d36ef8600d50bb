"""The type of the option `--cruise` for commands that accept several speeds."""

from __future__ import annotations

import click

__all__ = ["SPEEDS", "Speeds"]


class Speeds(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.4 only
    """Cruise speeds [m/s], written like a sweep axis: one value, several values, or a range with a count."""

    name = "V1,V2,...|LOW..HIGH:COUNT"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        """Return the cruise speeds, slowest first; InputError if the text is not a list or range of speeds."""
        from surctl.errors import InputError
        from surctl.marine.verification import cruise_speeds
        from surctl.tuning import Span, parse_axis

        key, text = "--cruise", str(value)
        single = text.split(",")
        if ".." not in text:
            try:
                return cruise_speeds([float(word) for word in single if word.strip() or len(single) > 1], key=key)
            except ValueError:
                pass
        else:
            try:
                axis = parse_axis(f"cruise={text}")
            except InputError as error:
                raise InputError(error.problem, key=key, value=text, remedy=f"write {self.name}") from None
            if not isinstance(axis, Span):
                return cruise_speeds(axis.values, key=key)
        raise InputError("is not a list of speeds", key=key, value=text, remedy=f"write {self.name}, in m/s")


SPEEDS = Speeds()

"""Parameters made of their words without typer's means where that is easy.

Typer converts by pydantic, which takes 0.1 s to import, also for texts, defaults, and options that
are not given.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from typer.core import TyperCommand, TyperGroup

_NUMBERS = {int: re.compile('-?[0-9]+'), float: re.compile(r'-?[0-9]+(\.[0-9]*)?')}
"""Plain numbers; typer knows others."""


class QuickCommand(TyperCommand):
    """A command of which most parameters are converted without typer."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Its parameters, with that for help."""
        return _quick(super().get_params(ctx))


class QuickGroup(TyperGroup):
    """A group of commands, as :class:`QuickCommand`."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Its parameters, with that for help."""
        return _quick(super().get_params(ctx))


def _quick(params: list[Any]) -> list[Any]:
    for param in params:
        usual = getattr(param, 'get_runtime_param', None)  # not in typer before 0.27
        if usual is not None and not isinstance(usual, partial):
            param.get_runtime_param = partial(_Converter, usual)
    return params


class _Converter:
    """In place of what typer converts with."""

    def __init__(self, usual: Callable[[], Any]) -> None:
        self._usual = usual

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        kind, info = param.type_descriptor.annotation, param.type_descriptor.parameter_info
        if value is None:
            return () if param.multiple or param.nargs == -1 else None
        if info.parser is None:
            if type(value) is kind:
                return value
            if kind == list[str] and isinstance(value, list | tuple):
                return [*value]
            if kind is Path and isinstance(value, str):
                from typer._param_types import coerce_cli_path

                return coerce_cli_path(Path(value), info, path_type=Path, param=param, ctx=ctx)
            if kind in _NUMBERS and isinstance(value, str) and _NUMBERS[kind].fullmatch(value):
                number = kind(value)
                if _within(number, info.min, info.max):  # else typer says what is wrong
                    return number
        return self._usual().coerce(value, param=param, ctx=ctx)


def _within(number: float, least: float | None, most: float | None) -> bool:
    return (least is None or number >= least) and (most is None or number <= most)

"""Parameters that are converted without typer: the same values, the same refusals, no pydantic."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Annotated, Any

import pytest
import typer
from typer.core import TyperCommand

from taxinet_ros.cli.quick import QuickCommand


def _upper(text: str) -> str:
    return text.upper()


def _command(cls: type[TyperCommand]) -> Any:
    app = typer.Typer(add_completion=False, rich_markup_mode=None)

    @app.command('it', cls=cls)
    def it(
        words: Annotated[list[str] | None, typer.Argument()] = None,
        text: Annotated[str, typer.Option()] = 'as it was',
        parsed: Annotated[str | None, typer.Option(parser=_upper)] = None,
        count: Annotated[int, typer.Option(min=1, max=900)] = 3,
        factor: Annotated[float | None, typer.Option(min=0.5)] = None,
        tight: Annotated[float, typer.Option(min=0, max=1, clamp=True)] = 0.5,
        flag: Annotated[bool, typer.Option('--flag')] = False,
        new: Annotated[Path | None, typer.Option()] = None,
        old: Annotated[Path | None, typer.Option(exists=True, dir_okay=False)] = None,
        pairs: Annotated[list[str] | None, typer.Option('--set')] = None,
        paths: Annotated[list[Path] | None, typer.Option('--path')] = None,
    ) -> None:
        """Do it."""

    @app.command('other')
    def other() -> None:
        """Do something else."""

    return typer.main.get_group(app).commands['it']


QUICK, USUAL = _command(QuickCommand), _command(TyperCommand)


def _outcome(command: Any, words: list[str]) -> Any:
    try:
        with command.make_context('it', list(words)) as context:
            return {name: (type(value), repr(value)) for name, value in context.params.items()}
    except typer.exceptions.TyperException as error:
        return error.format_message()


@pytest.mark.parametrize('words', [
    '', 'a b', '--text x', '--text 7', '--parsed x', '--flag', '--set a=1 --set b=2',
    '--path a --path b', '--new nowhere', '--new .', f'--old {__file__}', '--old nowhere',
    '--old .', *(f'--{name} {value}' for name in ('count', 'factor', 'tight') for value in (
        '1', '900', '901', '0', '-3', '+4', '0.5', '1.', '.5', '1e2', '1_0', 'nan', 'inf', 'x',
        '007', '٣',
    )),
])
def test_given_words_when_converted_then_the_values_or_the_refusal_are_typers(words: str) -> None:
    assert _outcome(QUICK, words.split()) == _outcome(USUAL, words.split())


def test_given_a_plain_command_when_read_then_pydantic_is_not_imported(tmp_path: Path) -> None:
    code = (
        'import sys; from taxinet_ros.cli.main import app; import taxinet_ros.cli.run.falsify;'
        'command = app.built.commands["falsify"];'
        f'app.built.make_context("taxinet", ["falsify"]);'
        f'words = ["s_falsif", "--runs", "20", "--out", {str(tmp_path)!r}, "--set", "rain=0"];'
        'print(command.make_context("falsify", words).params["runs"], "pydantic" in sys.modules)'
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert done.stdout == '20 False\n'

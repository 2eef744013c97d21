"""Every command line in the documentation is one that the command line takes.

Only reading is tested here: names of commands and options, their values as far as they name no
file, and the number of arguments. Where a shell completes the values of an option, these are the
words that it may have. What commands do, tests of their commands and of the tutorials tell.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from taxinet_ros.cli.main import app

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([
    *ROOT.glob('*.md'), *ROOT.glob('docs/**/*.md'), *ROOT.glob('examples/**/*.md'),
    *ROOT.glob('benchmarks/*.md'),
])
BLOCK = re.compile(r'^ *```(\S*)\n(.*?)^ *```$', re.MULTILINE | re.DOTALL)
SHELLS = ('sh', 'bash', 'shell', 'console')
TYPED = re.compile('taxinet [a-z]')
"""How a typed line begins in a block without a prompt that does not say that it is for a shell."""
OUTPUT = re.compile(r'\$\([^()]*\)')
VARIABLE = re.compile(r'\$\{[^}]*\}|\$\w+')
SPAN = re.compile(r'(?<!`)`(taxinet [^`]+)`(?!`)')
ENDS = {'|', '||', '&&', ';', '&', '(', ')', ';;'}
LEFT_OUT = '…'
"""What an author leaves out of a command that is shown in a sentence."""
PLACEHOLDER = '1'
"""What stands for a word that the reader is to fill in."""
OWN = re.compile(r'[./:]|[<>]')
"""What is in the name of a file, in a word for code of one's own, or in a formula."""
UNLISTED = {
    'external', 'bicycle', 'bright-paint', 'corners', 'damped', 'gentle', 'night-vision',
    'width=0.05',
}
"""A node that somebody else starts; what the package of docs/extending.md adds."""
ADDED = 'turns'
"""The command that the package of docs/extending.md adds."""
CLI = typer.main.get_command(app)


def lines(text: str) -> Iterator[str]:
    """Shell lines of the page's blocks, continued ones in one piece."""
    for language, block in BLOCK.findall(text):
        typed = list(whole(line.strip() for line in block.replace('\\\n', ' ').splitlines()))
        if prompted := [line[2:] for line in typed if line.startswith('$ ')]:
            yield from prompted  # the other lines are output
        else:
            yield from (line for line in typed if language in SHELLS or TYPED.match(line))


def whole(typed: Iterable[str]) -> Iterator[str]:
    """Lines, those within one quoted text in one piece."""
    held = ''
    for line in typed:
        held = f'{held}\n{line}' if held else line
        try:
            shlex.split(held, comments=True)
        except ValueError:
            continue
        yield held
        held = ''
    if held:
        yield held


def commands(line: str) -> Iterator[list[str]]:
    """The words after ``taxinet`` of all its calls in a shell line, without redirections."""
    lexer = shlex.shlex(
        VARIABLE.sub(PLACEHOLDER, OUTPUT.sub('', line)), posix=True, punctuation_chars='();<>|&'
    )
    lexer.whitespace_split = True
    words: list[str] | None = None
    after = ''
    for token in [*lexer, ';']:
        if token in ENDS:
            if words is not None:
                yield words
            words = None
        elif words is None:
            words = [] if Path(token).name == 'taxinet' else None
        elif set(token) <= set('<>&'):
            words = words[:-1] if words[-1:] == ['2'] else words
        elif not set(after) <= set('<>&') or not after:
            words.append(PLACEHOLDER if token.isupper() else token)  # as BAG or PID
        after = token


def command_of(words: list[str]) -> tuple[Any, list[str]]:
    """The command that the first words name, as the parser has it, and the other words."""
    command, rest = CLI, list(words)
    while hasattr(command, 'commands') and rest and rest[0][0].islower():
        found = command.commands.get(rest[0])
        assert found is not None, f'there is no command {rest[0]!r}'
        command, rest = found, rest[1:]
    return command, rest


def check(words: list[str]) -> None:
    """Read a command as the program would, up to values that name files.

    Raises:
        Exception: as the parser says what is wrong.
    """
    if words[:1] == [ADDED]:
        return
    command, rest = command_of(words)
    if '--help' in rest or '-h' in rest:
        return
    context = command.make_context('taxinet', rest)
    for one in command.params:
        values = context.params.get(one.name)
        for value in values if isinstance(values, list | tuple) else [values]:
            if isinstance(value, str) and not is_known(one, context, value):
                raise ValueError(f'{one.opts[0]} {value}: unknown')


def is_known(option: Any, context: Any, value: str) -> bool:
    """Whether a shell would offer the value, if it offers any for the option.

    Of ``key=value``, the key has to be one that it offers, and so has a value that is a word.
    """
    def offered(text: str) -> list[str]:
        return [item.value for item in option.shell_complete(context, text) if item.type == 'plain']

    key, equals, word = value.partition('=')
    if value in {PLACEHOLDER, *UNLISTED} or not offered('') or OWN.search(key):
        return True
    if not equals:
        return value in offered(value)
    if OWN.search(word) and option.name in ('specs', 'spec', 'formulas'):
        return True  # a formula with a name
    words = offered(f'{key}=')
    if not any(one.startswith(f'{key}=') for one in [*offered(key), *words]):
        return False
    return words in ([], [f'{key}=']) or value in words or OWN.search(word) is not None


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_given_a_page_then_the_command_line_takes_every_command_of_its_blocks(page):
    wrong = []
    for line in lines(page.read_text(encoding='utf-8')):
        for words in commands(line):
            try:
                check(words)
            except Exception as error:
                wrong.append(f'taxinet {shlex.join(words)}: {getattr(error, "message", error)}')
    assert wrong == []


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_given_a_page_then_commands_in_its_sentences_and_tables_have_their_options(page):
    wrong = []
    prose = re.sub(r'^ *```.*?^ *```$', '', page.read_text(encoding='utf-8'),
                   flags=re.MULTILINE | re.DOTALL)
    for span in SPAN.findall(prose):
        text = ' '.join(span.split())
        try:
            command, rest = command_of(re.split(r'[\s|,]+', text.partition(LEFT_OUT)[0])[1:])
        except AssertionError as error:
            wrong.append(f'{text}: {error}')
            continue
        known = {word for one in command.params for word in (*one.opts, *one.secondary_opts)}
        known |= {'--help', '-h'}
        asked = set(re.findall(r'(?<![\w-])--?[a-z][\w-]*', ' '.join(rest)))
        wrong += [f'{text}: {option}' for option in sorted(asked - known)]
    assert wrong == []


def test_given_the_pages_then_they_have_many_commands_of_all_kinds():
    text = '\n'.join(page.read_text(encoding='utf-8') for page in PAGES)
    found = [words for line in lines(text) for words in commands(line)]
    assert len(found) > 180, len(found)
    assert len({tuple(words[:1]) for words in found if words}) > 30


@pytest.mark.parametrize(('line', 'found'), [
    ('taxinet run nominal --out bags/x   # a remark', [['run', 'nominal', '--out', 'bags/x']]),
    ("A=1 nice .venv/bin/taxinet run 'a b' 2>&1 | tee log && taxinet gate x > y",
     [['run', 'a b'], ['gate', 'x']]),
    ('for i in 1 2; do taxinet gate "$i"; done', [['gate', '1']]),
    ('ros2 run taxinet_ros recorder', []),
])
def test_given_a_shell_line_then_its_calls_are_found(line, found):
    assert list(commands(line)) == found


@pytest.mark.parametrize('words', [
    ['fly', 'nominal'], ['run', 'nominal', '--rums', '3'], ['run', 'nominal', '--runs', 'x'],
    ['fork'], ['localize', 'a', 'b'],
    ['run', 'nominal', '--engine', 'lopp'], ['falsify', 'nominal', '--sampler', 'hallton'],
    ['run', 'nominal', '--images', 'some'], ['run', 'nominal', '--set', 'cluods=clear'],
    ['run', 'nominal', '--set', 'clouds=claer'], ['run', 'nominaal'],
    ['bag', 'doktor', 'x'], ['run', 'nominal', '--out'],
])
def test_given_a_command_with_a_mistake_then_it_is_noticed(words):
    with pytest.raises(Exception, match=r'\w'):
        check(words)

"""Reference pages as Markdown, made from the code, messages and files that they describe."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import typer

import taxinet_ros as tx
from taxinet_ros import errors
from taxinet_ros.bag.run.topics import BASE_FRAME, CAMERA_FRAME, MAP_FRAME
from taxinet_ros.cli.help import EXAMPLES
from taxinet_ros.cli.main import app
from taxinet_ros.cli.run.node import NODES
from taxinet_ros.core import topics
from taxinet_ros.core.scenario_fields import BY_KEY, SCENARIO_FIELDS, ScenarioField
from taxinet_ros.nodes.running.parameters import Parameter
from taxinet_ros.trials.record.row import ATTRIBUTES, RunRow
from taxinet_ros.trials.record.table import table

ROOT = Path(__file__).resolve().parents[2]
LIVE_MONITOR = 'taxinet_ros.extras.live_monitor.node'


def other_pages() -> str:
    """Pages of ``docs/`` that the menu in ``index.md`` does not name, a line each."""
    named = (ROOT / 'docs' / 'index.md').read_text(encoding='utf-8').splitlines()
    pages = sorted(page.stem for page in (ROOT / 'docs').glob('*.md'))
    return '\n'.join(page for page in pages if page not in (*named, 'index'))


def commands() -> str:
    """Every command with its arguments and options, from the parsers themselves."""
    root = typer.main.get_command(app)
    with root.context_class(root, info_name='taxinet') as context:
        return '\n'.join(_command_lines(root, context, 'taxinet', 2))


def _command_lines(group: Any, context: Any, name: str, level: int) -> Iterator[str]:
    for word in group.list_commands(context):
        child = group.get_command(context, word)
        full = f'{name} {word}'
        with child.context_class(child, info_name=word, parent=context) as inside:
            yield f'\n{"#" * level} {full}\n'
            yield _plain(inspect.cleandoc(child.help or ''))
            if hasattr(child, 'list_commands'):
                yield from _command_lines(child, inside, full, level + 1)
            else:
                pieces = ' '.join(child.collect_usage_pieces(inside))
                yield f'\n```text\n{full} {pieces}\n```\n'
                yield from _option_lines(child, inside)
                yield from _example_lines(full.partition(' ')[2])


def _example_lines(command: str) -> Iterator[str]:
    lines = EXAMPLES.get(command, ())
    if lines:
        yield '\n'.join(['\n```sh', *lines, '```'])


def _option_lines(command: Any, context: Any) -> Iterator[str]:
    for option in command.get_params(context):
        record = option.get_help_record(context)
        if record is None or option.name == 'help':
            continue
        words, told = (' '.join(text.split()) for text in record)
        yield f'\n`{words}`\n: {_plain(told) or "no further description"}'


def _plain(text: str) -> str:
    """Text whose stars, pipes and angle brackets are no markup."""
    parts = re.split(r'(`[^`]*`)', text)
    return ''.join(
        part if part.startswith('`') else re.sub(r'([*_|<>\[\]])', r'\\\1', part)
        for part in parts
    )


def python_names() -> str:
    """Every public name of the package, by Sphinx's autodoc."""
    lines = []
    for name in tx.__all__:
        thing = getattr(tx, name)
        kind = 'function'
        if inspect.isclass(thing):
            kind = 'exception' if issubclass(thing, Exception) else 'class'
        members = ['   :members:', '   :exclude-members: __init__'] if kind == 'class' else []
        lines += [
            f'\n## {name}\n', '```{eval-rst}', f'.. auto{kind}:: taxinet_ros.{name}', *members,
            '```',
        ]
    return '\n'.join(lines)


def messages() -> str:
    """Every message and action with its constants and fields, from their definitions."""
    files = [*(ROOT / 'msg_defs' / 'msg').glob('*.msg'), *(ROOT / 'msg_defs' / 'action').iterdir()]
    return '\n'.join(_definition(file) for file in sorted(files))


def _definition(file: Path) -> str:
    parts = re.split(r'^---\n', file.read_text(encoding='utf-8'), flags=re.MULTILINE)
    intro, rows = _fields(parts[0])
    folder = file.suffix.removeprefix('.')
    told = [f'\n## taxinet_msgs/{folder}/{file.stem}\n\n{intro}\n']
    if len(parts) == 1:
        return '\n'.join([*told, _table(('field', 'type', 'what'), rows)])
    for part, text in zip(('goal', 'result', 'feedback'), parts, strict=True):
        told.append(_table((part, 'type', 'what'), _fields(text)[1]) + '\n')
    return '\n'.join(told)


def _fields(text: str) -> tuple[str, list[list[str]]]:
    """Comments before the first field, and a row for each field or constant."""
    intro: list[str] = []
    rows: list[list[str]] = []
    for line in text.splitlines():
        code, _, comment = (word.strip() for word in line.partition('#'))
        if code:
            kind, _, name = code.partition(' ')
            rows.append([f'`{name.strip()}`', kind, comment])
        elif rows and line.startswith(' '):
            rows[-1][2] += f' {comment}'  # goes on from the line before
        elif rows and comment:
            rows.append(['', '', comment])
        elif comment:
            intro.append(comment)
    return ' '.join(intro), rows


def parameters() -> str:
    """Every node with its topics and parameters, from what it declares."""
    modules = [*(f'taxinet_ros.nodes.{name}' for name in NODES), LIVE_MONITOR]
    return '\n'.join(_node(importlib.import_module(module)) for module in modules)


def _node(module: ModuleType) -> str:
    usage = module.USAGE
    told = [f'\n## `{usage.executable}`\n', usage.does, '']
    for word, names in (('Publishes', usage.publishes), ('Subscribes to', usage.subscribes)):
        if names:
            told.append(f'{word} {", ".join(f"`{name}`" for name in names)}.\n')
    if usage.other:
        told.append(f'Also: {usage.other}.\n')
    rows = [_parameter(one) for one in usage.parameters]
    told.append(_table(('parameter', 'default', 'may be', 'what'), rows) if rows else '')
    if usage.ends:
        told.append(f'\nFurther exit codes: {"; ".join(usage.ends)}.')
    return '\n'.join(told)


def _parameter(one: Parameter) -> list[str]:
    default = str(one.default).lower() if isinstance(one.default, bool) else one.default
    if isinstance(default, float):
        default = f'{default:g}'
    if isinstance(default, list):
        default = ', '.join(map(str, default))
    return [f'`{one.name}`', str(default), one.allowed, one.description]


def scenario_keys() -> str:
    """Every key of a scenario, from the table that the code itself uses.

    It stands in ``reference/scenario.md``, to be read in the repository too; a test compares them,
    and ``python docs/_site/generated.py`` prints it.
    """
    plain = tx.Scenario()
    return _table(
        ('key', 'may be', 'default', 'what'),
        [_scenario_key(field, getattr(plain, field.attribute)) for field in SCENARIO_FIELDS],
    )


def _scenario_key(field: ScenarioField, default: Any) -> list[str]:
    later = '; may change within a run' * field.varies
    return [f'`{field.key}`', field.allowed, field.as_typed(default), f'{field.title}{later}']


def columns() -> str:
    """Every column of a campaign's table, with what the row says of it."""
    told = _attributes(RunRow)
    frame = table([], ['FORMULA'])
    rows = []
    for name, kind in frame.dtypes.items():
        attribute = ATTRIBUTES.get(name, name)
        what = BY_KEY[name].title if name in BY_KEY else told.get(attribute, _OTHER.get(name, ''))
        rows.append([f'`{name}`', str(kind), what])
    return _table(('column', 'type', 'what'), rows)


_OTHER = {
    'rho': 'robustness of the headline, the first formula',
    'rho_FORMULA': 'robustness of each formula, in its own unit; positive satisfies',
    'rho_lower.FORMULA': 'least robustness still possible, where the run was stopped early',
    'rho_upper.FORMULA': 'greatest, likewise',
    'real_time_factor': 'simulated time per wall-clock time',
}


def topics_in_bags() -> str:
    """The topics of a bag, from the table that the nodes themselves use."""
    rows = [
        [f'`/{one.name.lstrip("/")}`', f'`{one.type_name}`', one.recorded,
         'latched' if one.quality.latched else 'volatile', one.carries]
        for one in (*topics.TOPICS, *topics.TRANSFORMS) if one.recorded
    ]
    frames = f'Frames: `{MAP_FRAME}` → `{BASE_FRAME}` → `{CAMERA_FRAME}`.'
    return f'{_table(("topic", "type", "messages", "durability", "carries"), rows)}\n\n{frames}'


def exit_codes() -> str:
    """Exit codes of commands and nodes."""
    told = _attributes(errors.ExitCode)
    rows = [[str(int(code)), code.name, told[code.name]] for code in errors.ExitCode]
    return _table(('code', 'name', 'when'), rows)


def infra_kinds() -> str:
    """Kinds of infrastructure errors."""
    told = _member_docstrings(errors.InfraKind)
    rows = [[f'`{kind}`', told[kind.name]] for kind in errors.InfraKind]
    return _table(('kind', 'what happened'), rows)


def exceptions() -> str:
    """Exceptions of the Python API and what becomes of them on the command line."""
    classes = [
        one for name in tx.__all__
        if inspect.isclass(one := getattr(tx, name)) and issubclass(one, Exception)
    ]
    rows = [[f'`tx.{one.__name__}`', (inspect.getdoc(one) or '').split('\n\n')[0]]
            for one in classes]
    return _table(('exception', 'means'), rows)


def examples() -> str:
    """The example files, whole."""
    files = [
        file for file in sorted((ROOT / 'examples').rglob('*'))
        if file.is_file() and file.stat().st_size and file.suffix in _LANGUAGES
        and '__pycache__' not in file.parts
    ]
    return '\n'.join(
        f'\n## {file.relative_to(ROOT / "examples")}\n\n'
        f'```{_LANGUAGES[file.suffix]}\n{file.read_text(encoding="utf-8").rstrip()}\n```'
        for file in files
    )


_LANGUAGES = {'.py': 'python', '.yaml': 'yaml', '.toml': 'toml', '.cpp': 'cpp'}


def example_anchor(inside: str) -> str:
    """Anchor of an example's heading; a folder's is that of the page."""
    if Path(inside).suffix not in _LANGUAGES:
        return ''
    return '#' + re.sub(r'[^\w\- ]', '', inside.lower())


def _attributes(documented: type) -> dict[str, str]:
    """Text of each name in the section ``Attributes`` of a class's docstring."""
    section = (inspect.getdoc(documented) or '').split('Attributes:\n', 1)[1]
    found: dict[str, str] = {}
    for names, text in re.findall(
        r'^    (\w+(?:,\s+\w+)*): (.*(?:\n     +.*)*)', section, re.MULTILINE
    ):
        shared = ' '.join(text.split())
        for name in re.split(r',\s+', names):
            found[name] = _cross_references_plain(shared)
    return found


def _cross_references_plain(text: str) -> str:
    """Sphinx roles as code: ``:class:`~a.b.C``` becomes ```C```."""
    text = re.sub(r':\w+:`~?([\w.]+)`', lambda role: f'`{role[1].rsplit(".", 1)[-1]}`', text)
    return text.replace('``', '`')


def _member_docstrings(enumeration: type) -> dict[str, str]:
    """The string after each member of an enumeration."""
    (body,) = ast.parse(textwrap.dedent(inspect.getsource(enumeration))).body
    assert isinstance(body, ast.ClassDef)
    return {
        member.targets[0].id: said.value.value
        for member, said in zip(body.body, body.body[1:], strict=False)
        if isinstance(member, ast.Assign) and isinstance(said, ast.Expr)
    }


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    def line(cells: Iterable[str]) -> str:
        return '| ' + ' | '.join(' '.join(_cell(cell).split()) for cell in cells) + ' |'

    head = list(head)
    return '\n'.join([line(head), line(['---'] * len(head)), *map(line, rows)])


def _cell(text: str) -> str:
    """A cell's text: a pipe would end it, a star or bracket would be markup."""
    parts = re.split(r'(`[^`]*`)', _cross_references_plain(text))
    return ''.join(
        part if part.startswith('`') else re.sub(r'([*<>|\[\]])', r'\\\1', part) for part in parts
    )


PAGES: dict[str, Callable[[], str]] = {
    function.__name__: function for function in (
        other_pages, commands, python_names, messages, parameters, columns, topics_in_bags,
        exit_codes, infra_kinds, exceptions, examples,
    )
}
"""Functions by the name that a page's placeholder has."""

if __name__ == '__main__':
    print(scenario_keys())

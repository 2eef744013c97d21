"""``taxinet plugins``: every name, whose it is, and whether it can be used."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
import typer
from plugins import lay_down

from taxinet_ros import registry
from taxinet_ros.cli.main import app, main
from taxinet_ros.core.motion.controller import make_controller
from taxinet_ros.errors import UsageError
from taxinet_ros.version import __version__

CODE = 'def look(image):\n    return 0.0, 0.0\n\nWORDS = "steer"\n'


@pytest.fixture
def plugins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Runs ``taxinet plugins`` where three packages are installed, one of them broken."""
    monkeypatch.syspath_prepend(str(tmp_path))
    lay_down(tmp_path, 'cli-eyes', CODE, perceptions='mine = look', controllers='words = WORDS')
    lay_down(tmp_path, 'cli-broken', 'import no_such_module\n', worlds='moon = Moon')
    lay_down(tmp_path, 'cli-twin', 'X = "always(cte <= 1)"\n', '0.3', requirements='usable = X')

    def run(*words: str) -> tuple[int, str]:
        monkeypatch.setattr(sys, 'argv', ['taxinet', 'plugins', *words])
        with pytest.raises(SystemExit) as end:
            main()
        told = capsys.readouterr()
        return int(end.value.code or 0), told.out + told.err

    return run


def test_given_packages_when_listed_then_each_name_is_told_with_its_package(plugins) -> None:
    code, told = plugins()
    assert code == 0
    lines = [line.split() for line in told.splitlines()]
    assert [kind for [kind, *more] in lines if not more] == list(registry.SHIPPED)
    assert ['mine', 'cli-eyes', '1.2', 'cli_eyes:look'] in lines
    assert ['kmwh', 'shipped', 'taxinet_ros.core.world:SimulatedWorld'] in lines
    [broken] = [line for line in told.splitlines() if 'no_such_module' in line]
    assert broken.strip().startswith('cannot be used: world moon of cli-broken 1.2: ')
    assert 'cli_eyes:WORDS is str; expected a function or class' in told
    assert told.count('requirement usable: there are two, of taxinet_ros') == 2


def test_given_a_name_when_asked_for_then_the_exit_code_says_whether_it_can_be_used(
    plugins,
) -> None:
    code, told = plugins('mine')
    assert code == 0
    assert told.splitlines()[0] == 'perceptions'
    assert len(told.splitlines()) == 2
    code, told = plugins('moon')
    assert (code, "No module named 'no_such_module'" in told) == (2, True)
    code, told = plugins('nobody')
    assert (code, "nothing is called 'nobody'" in told) == (2, True)


def test_given_commands_of_packages_then_they_are_listed_completed_and_called_by_name(
    plugins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code = 'import typer\ndef mine(word: str):\n    """Say a word."""\n    print(word)\n'
    group = code + 'app = typer.Typer()\napp.command()(mine)\n'
    lay_down(tmp_path, 'cmd-group', group, commands='grouped = app')
    lay_down(tmp_path, 'cmd-odd', 'ODD = 3\n', commands='unread = ODD')
    lay_down(tmp_path, 'cmd-run', code, commands='run = mine')
    for name in ('one', 'two'):
        lay_down(tmp_path, f'cmd-{name}', code, commands='twice = mine')
    root = typer.main.get_command(app)

    def run(*words: str) -> tuple[int, str]:
        monkeypatch.setattr(sys, 'argv', ['taxinet', *words])
        with pytest.raises(SystemExit) as end:
            main()
        return int(end.value.code or 0), ''.join(capsys.readouterr())

    assert list(root.commands)[-3:] == ['grouped', 'twice', 'unread']
    assert '  grouped         Command of cmd-group 1.2.\n' in run('-h')[1]
    assert run('grouped', 'mine', 'a') == (0, 'a\n')
    assert run('run', '-h')[1].startswith('Usage: taxinet run [OPTIONS] ')
    for name, words in (('unread', 'command unread of cmd-odd 1.2: '), ('twice', 'there are two')):
        for code, told in (run(name, 'a'), plugins(name)):
            assert (code, words in told) == (2, True), told
    assert 'taxinet itself has a command of this name' in plugins('run')[1]


@pytest.mark.parametrize(('point', 'name', 'words'), [
    ('perceptions', 'both', 'both cannot be called with one argument'),
    ('controllers', 'both', 'both cannot be called with one argument'),
    ('controllers', 'Both', 'Both cannot be called with one argument'),
    ('worlds', 'both', 'both cannot be called as'),
    ('samplers', 'KIND', 'its make cannot be called as make(space, seed, runs, values)'),
    ('samplers', 'NAMED', 'its make cannot be called as make(space, seed, runs, values)'),
])
def test_given_code_that_takes_other_arguments_then_it_cannot_be_used(
    plugins, tmp_path: Path, point: str, name: str, words: str
) -> None:
    code = (
        'from taxinet_ros.samplers.registry import SamplerKind, proposer_kind\n'
        'def both(one, two):\n    return one\n'
        'class Both:\n    def __call__(self, one, two):\n        return one\n'
        'KIND = SamplerKind(meaning="two", make=both)\n'
    )
    code += 'NAMED = proposer_kind("two", both, floor=0.0)\n' if name == 'NAMED' else ''
    lay_down(tmp_path, f'cli-{point}-{name.lower()}', code, **{point: f'two = {name}'})
    if name == 'Both':  # What it makes is seen when it is made only.
        with pytest.raises(UsageError, match=words):
            make_controller('two', {})
        return
    told = plugins('two')
    assert (told[0], words in told[1]) == (2, True), told


def test_given_json_when_asked_for_then_it_tells_the_same(plugins) -> None:
    code, told = plugins('--json')
    assert code == 0
    found = {(one['kind'], one['name'], one['distribution']): one for one in json.loads(told)}
    names = {kind: [name for of, name, _ in found if of == kind] for kind in registry.SHIPPED}
    assert names['samplers'] == registry.names(registry.SAMPLERS)
    assert found['perceptions', 'mine', 'cli-eyes'] == {
        'kind': 'perceptions', 'name': 'mine', 'target': 'cli_eyes:look',
        'distribution': 'cli-eyes', 'version': '1.2', 'shipped': False, 'usable': True,
        'trouble': '',
    }
    truth = found['perceptions', 'truth', 'taxinet_ros']
    assert (truth['shipped'], truth['version'], truth['usable']) == (True, __version__, True)
    moon = found['worlds', 'moon', 'cli-broken']
    assert (moon['usable'], 'no_such_module' in moon['trouble']) == (False, True)

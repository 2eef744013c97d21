"""``taxinet --help`` and examples: whatever lists commands knows them all."""

import shlex
import subprocess
import sys

import pytest
import typer

from taxinet_ros.cli import progress
from taxinet_ros.cli.commands import OWN, SECTIONS, first_sentence
from taxinet_ros.cli.help import EXAMPLES
from taxinet_ros.cli.main import app
from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.errors import UsageError
from taxinet_ros.registry import COMMANDS, SHIPPED
from taxinet_ros.scenes.programs import known_programs

ROOT = typer.main.get_command(app)


def commands(group=ROOT, above=''):
    """Every command by its words, apart from groups."""
    found = {}
    for name, command in group.commands.items():
        words = f'{above}{name}'
        deeper = hasattr(command, 'commands')
        found |= commands(command, f'{words} ') if deeper else {words: command}
    return found


def test_given_the_commands_then_each_is_in_one_section_and_has_an_example():
    assert len(OWN) == sum(map(len, SECTIONS.values())) >= 40
    assert {name for name, target in OWN.items() if not target} == set(SHIPPED[COMMANDS])
    assert sorted(EXAMPLES) == sorted(commands())
    assert all(EXAMPLES.values())


@pytest.mark.parametrize('name', OWN)
def test_given_a_command_then_its_line_in_the_list_is_the_first_sentence_of_its_own_text(name):
    assert ROOT.commands[name].get_short_help_str(300) == first_sentence(name)


def test_given_the_help_when_printed_then_no_command_is_imported():
    code = (
        'import sys; from taxinet_ros.cli.main import app; '
        'app(["-h"], standalone_mode=False); '
        'print([name for name in sys.modules if name.startswith("taxinet_ros.cli.") and '
        'name.endswith("commands")], "numpy" in sys.modules)'
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "['taxinet_ros.cli.commands'] False"


def test_given_the_help_of_each_command_then_nothing_that_takes_long_is_imported():
    code = (
        'import sys; from taxinet_ros.cli.commands import SECTIONS; '
        'from taxinet_ros.cli.main import app; '
        '[app([name, "-h"], standalone_mode=False) for names in SECTIONS.values() '
        ' for name, place in names.items() if place]; '
        'print({"matplotlib", "pandas", "rclpy", "scipy", "torch"} & {*sys.modules})'
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == 'set()'


@pytest.mark.parametrize('line', [line for lines in EXAMPLES.values() for line in lines])
def test_given_an_example_when_parsed_then_its_command_takes_it_and_its_program_exists(line):
    first, *words = shlex.split(line)
    assert first == 'taxinet'
    command, path = ROOT, []
    while hasattr(command, 'commands'):
        path.append(words.pop(0))
        command = command.commands[path[-1]]
    context = command.make_context(' '.join(path), words)
    assert context.params.get('scenario') in (None, *known_programs())
    assert line in EXAMPLES[' '.join(path)]


def test_given_the_help_when_printed_then_it_has_the_sections_in_order_and_whole_sentences(capsys):
    for word in ('-h', '--help'):
        app([word], standalone_mode=False, prog_name='taxinet')
        out = capsys.readouterr().out
        places = [out.index(f'\n{title}:\n') for title in SECTIONS]
        assert places == sorted(places)
        assert '...' not in out.split('Run scenes:')[1]
    app(['run', '-h'], standalone_mode=False, prog_name='taxinet')
    out = capsys.readouterr().out
    assert all(f'\n    {line}\n' in out for line in EXAMPLES['run'])


@pytest.mark.parametrize(('words', 'hint'), [
    (['--nope'], 'see taxinet --help'), (['nope'], 'see taxinet --help'),
    (['run', '--nope'], 'see taxinet run --help'), (['bag', 'nope'], 'see taxinet bag --help'),
    (['bag', 'info'], 'see taxinet bag info --help'),
    (['falsify', 's_falsif', '--runs', 'x'], 'see taxinet falsify --help'),
])
def test_given_wrong_words_then_the_error_names_the_help_of_its_command(words, hint, monkeypatch,
                                                                        capsys):
    from taxinet_ros.cli.main import main

    monkeypatch.setattr(sys, 'argv', ['taxinet', *words])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    assert capsys.readouterr().err.rstrip().endswith(hint)


def test_given_no_terminal_when_a_command_is_long_then_a_line_now_and_then_says_how_far(
    monkeypatch, capsys
):
    now = [100.0]
    monkeypatch.setattr(progress.time, 'monotonic', lambda: now[0])
    monkeypatch.delenv(progress.HEARTBEAT)
    with stage_bars(progress.Console()) as show:
        for done in range(1, 31):
            now[0] += 1
            show('reading', done, 30)
        show('drawing', 1, 4)
        for done in (50, 75, 99, 100, 100):  # of which 50 were done before the command
            now[0] += 10 if done < 99 else 0.1
            show('running', done, 100)
    out, err = capsys.readouterr()
    assert out == ''
    assert err.splitlines() == [
        'reading: 10 of 30, about 0:00:20 left', 'reading: 20 of 30, about 0:00:10 left',
        'reading: 30 of 30', 'running: 50 of 100', 'running: 75 of 100, about 0:00:10 left',
        'running: 100 of 100',
    ]


@pytest.mark.parametrize('text', ['often', '-1', 'nan'])
def test_given_another_heartbeat_then_it_is_refused_by_name(text, monkeypatch):
    monkeypatch.setenv(progress.HEARTBEAT, text)
    with pytest.raises(UsageError, match=f'TAXINET_HEARTBEAT_S={text}: expected seconds'), \
            stage_bars(progress.Console()):
        pass

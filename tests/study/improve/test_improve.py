"""The loop of ``taxinet improve``, with stages that leave behind what theirs would, in no time."""

import shutil
from pathlib import Path

import pytest
from network_samples import card_of, random_weights, save_sample
from recorded_runs import record_runs

from taxinet_ros.core.mtl import exact_intervals
from taxinet_ros.core.perception.weights import load_model, save_model, to_bytes
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.files.sealed_json import write_sealed
from taxinet_ros.study.improve.loop import (
    BEST,
    FALSIFY,
    JUDGE,
    TRAIN,
    ImproveOptions,
    improve_network,
)
from taxinet_ros.study.stages.run import StoppedError
from taxinet_ros.trials.record.row import RunRow

RUNS = 40


class Bench:
    """Does the stages of a loop; so many runs of each campaign fail, none by default."""

    def __init__(self, out: Path, failures: dict[str, int], stop_at: str = '') -> None:
        self.out, self.failures, self.stop_at = out, failures, stop_at
        self.done: list[str] = []
        self.commands: dict[str, tuple[str, ...]] = {}

    def run(self, stages) -> None:
        for stage in stages:
            if stage.name == self.stop_at:
                raise StoppedError(130)
            assert stage.ready(self.out), stage.name
            self.commands[stage.name] = stage.words()
            if not (self.out / stage.name).exists():
                (self.out / stage.name).mkdir()
                self.done.append(stage.name)
                self.leave(stage)
            assert stage.results(self.out).keys() == set(stage.outputs)

    def leave(self, stage) -> None:
        folder, word = self.out / stage.name, stage.command
        if word == 'falsify':
            (folder / 'runs.parquet').write_text('')
            campaign(folder, self.failures.get(stage.name, 0))
        elif word == 'analyze':
            (folder / 'report.html').write_text('')
            region = [{'feature': 'rain_percent', 'low': 25.0, 'high': None}]
            found = {'causes': [{'words': 'rain', 'region': region}]}
            write_sealed(folder / 'analysis.json', found)
        else:
            data = to_bytes(random_weights(len(self.done)))
            save_model(folder / 'candidate.safetensors', data, card_of(data))


def campaign(folder: Path, failures: int) -> None:
    record_runs(folder, {'program': 's_falsif.scenic'}, [
        RunRow(
            run_id=f'r{index}', index=index, program='s', seed=0, perception='p',
            outcome=Outcome.FAIL if index < failures else Outcome.PASS,
            robustness=exact_intervals({'phi': -1.0 if index < failures else 1.0}),
            cross_track_m=0.0, distance_m=50.0 * index, heading_deg=0.0, clouds='clear',
            rain_percent=0.0, time_of_day_h=12.0, left_runway=False,
        ) for index in range(RUNS)
    ])


@pytest.fixture
def begun(tmp_path):
    """Options of a loop of two rounds, and its folder."""
    out = tmp_path / 'out'
    out.mkdir()
    options = ImproveOptions(
        start=str(save_sample(tmp_path)), rounds=2, budget=RUNS * 3 * 2, counterexamples=70,
        margin=0.1,  # on 40 scenes less than 7 points cannot be shown
    )
    return options, out


def go(options: ImproveOptions, out: Path, bench: Bench):
    rounds = []
    try:
        rounds.extend(improve_network(out, options, bench.run))
    except StoppedError as stopped:
        return stopped.code, rounds
    return 0, rounds


def test_given_a_better_candidate_then_the_next_round_goes_on_from_it(begun):
    options, out = begun
    bench = Bench(out, {
        'round-1-falsify': 12, 'round-1-incumbent': 9, 'round-1-candidate': 0,
        'round-2-falsify': 3, 'round-2-incumbent': 2, 'round-2-candidate': 2,
    })
    code, (one, two) = go(options, out, bench)
    assert code == 0
    assert (one.searched, one.failed, one.decision.accepted) == (RUNS, 12, True)
    assert one.causes == ('rain',)
    assert (two.incumbent, two.decision.accepted) == (one.candidate, False)
    first, second = (bench.commands[f'round-{n}-train'] for n in (1, 2))
    assert first[first.index('--start') + 1] == 'start.safetensors'
    assert second[second.index('--start') + 1] == 'round-1-train/candidate.safetensors'
    # What was learned in the first round is learned in the second one too.
    assert second.count('--add-runs') == 2
    assert 'round-1-falsify=70' in second
    best = load_model(out / BEST).card
    assert best.weights_sha256 == one.candidate


def test_given_no_candidate_that_is_better_then_the_network_stays_what_it_was(begun):
    options, out = begun
    failing = {f'round-{n}-{kind}': 5 for n in (1, 2)
               for kind in ('falsify', 'incumbent', 'candidate')}
    code, rounds = go(options, out, Bench(out, failing))
    assert code == 0
    assert [one.decision.why for one in rounds] == ['not significantly better'] * 2
    start = load_model(options.start_path).fingerprint
    assert load_model(out / BEST).fingerprint == start == rounds[1].incumbent


def test_given_no_failure_then_the_loop_ends_there_and_says_so(begun):
    options, out = begun
    bench = Bench(out, {})
    code, (only,) = go(options, out, bench)
    assert (code, only.decision, only.failed, only.searched) == (0, None, 0, RUNS)
    assert bench.done == ['round-1-falsify']
    assert (out / BEST).exists()


def test_f1_given_a_disk_that_was_full_while_the_start_was_copied_then_it_goes_on(
    begun, monkeypatch
):
    options, out = begun
    copy = shutil.copyfile
    with monkeypatch.context() as full:

        def half(source: Path, target: Path) -> None:
            if Path(source).suffix == '.safetensors':
                Path(target).write_bytes(Path(source).read_bytes()[:1000])
                raise OSError(28, 'No space left on device')
            copy(source, target)

        full.setattr(shutil, 'copyfile', half)
        with pytest.raises(OSError, match='No space left'):
            go(options, out, Bench(out, {}))
    assert not (out / 'start.safetensors').exists(), 'nothing half-written'
    assert go(options, out, Bench(out, {}))[0] == 0


def test_given_an_interrupt_when_called_again_then_nothing_is_done_or_written_twice(begun):
    options, out = begun
    failing = {f'round-{n}-{kind}': 5 for n in (1, 2)
               for kind in ('falsify', 'incumbent', 'candidate')}
    code, rounds = go(options, out, Bench(out, failing, stop_at='round-2-candidate'))
    assert (code, len(rounds)) == (130, 1)
    assert not (out / BEST).exists()
    again = Bench(out, failing)
    code, rounds = go(options, out, again)
    assert (code, len(rounds)) == (0, 2)
    assert again.done == ['round-2-candidate']
    assert [one.number for one in rounds] == [1, 2]


def test_given_the_seeds_of_all_rounds_then_no_two_are_equal():
    options = ImproveOptions(rounds=100, budget=3000)
    seeds = [options.seed_of(n, purpose) for n in range(1, 101) for purpose in (FALSIFY, TRAIN,
                                                                               JUDGE)]
    assert len(set(seeds)) == 300
    assert min(seeds) > 100_000  # and none that a person is likely to judge by


def test_given_both_networks_of_a_round_then_their_scenes_are_the_same_and_new(begun):
    options, out = begun
    bench = Bench(out, {'round-1-falsify': 4, 'round-2-falsify': 4})
    go(options, out, bench)
    seeds = {
        name: words[words.index('--seed') + 1] for name, words in bench.commands.items()
        if '--seed' in words
    }
    assert seeds['round-1-incumbent'] == seeds['round-1-candidate']
    assert len(set(seeds.values())) == 6


@pytest.mark.parametrize(('change', 'reason'), [
    ({'rounds': 0}, 'rounds is 0, outside 1..100'),
    ({'budget': 15, 'rounds': 3}, 'leaves 1 runs for each of the three campaigns'),
    ({'learning_rate': float('nan')}, 'learning_rate is nan'),
    ({'sampler': 'dice'}, "sampler 'dice' is unknown"),
])
def test_given_what_cannot_be_when_stated_then_one_line_says_so(change, reason):
    with pytest.raises(UsageError, match=r'^improve: ') as caught:
        ImproveOptions(**change)
    assert reason in str(caught.value)


def test_given_a_program_by_its_path_then_it_is_found_from_any_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path('mine.scenic').write_text('model runway_world\nego = new Plane at (0, 100)\n')
    found = ImproveOptions(program='mine.scenic', add=('mine.scenic=3', 'crossing=2')).checked()
    assert found.program == str(tmp_path / 'mine.scenic')
    assert found.base == 'training_full'
    assert found.add == (f'{tmp_path}/mine.scenic=3', 'crossing=2')

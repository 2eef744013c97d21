"""A cause's program draws scenes of the cause, and nothing else."""

from planted_runs import planted_runs, planted_table

from taxinet_ros.analysis.cause_program import cause_program, confirming, program_name
from taxinet_ros.analysis.causes import Cause, FoundRate
from taxinet_ros.analysis.failure_region import Either, Interval, Kinds, Region, Slant, part_of
from taxinet_ros.campaign.scene_source import sample_scenarios

PARTS = (
    Slant(feature='cross_track_m', other='heading_deg', factor=-0.27, low=1.0, high=None),
    Kinds(feature='clouds', kinds=('overcast', 'stratus')),
    Either(first=Interval(feature='time_of_day_h', low=None, high=9.0),
           second=Interval(feature='distance_m', low=1000.0, high=None)),
)


def test_t5_given_a_cause_of_any_kind_then_its_program_draws_scenes_of_it_alone(tmp_path):
    table = planted_table(40, 1, lambda t: 0.5).assign(program='s_falsif.scenic')
    runs = planted_runs(table, tmp_path)
    rate = FoundRate(40, 20, 0.5, 0.3, 0.7)
    cause = Cause(region=Region(parts=PARTS), rank=1, inside=rate, outside=rate, whole=rate,
                  share=0.5, added=0.5, attributable=(0.0, 0.0, 0.0), p=0.01, p_is_bound=False)
    program = tmp_path / program_name(cause)
    program.write_text(cause_program(runs, cause))
    for scene in sample_scenarios(program, 5, 6):
        values = scene.to_human()
        assert values['cross_track'] - 0.27 * values['heading'] >= 1 - 1e-6
        assert values['clouds'] in ('overcast', 'stratus')
        assert (values['time_of_day'] <= 9) != (values['distance'] >= 1000)
    command = confirming(runs, cause, tmp_path)
    assert command.startswith(f'taxinet run {program} --runs 100 --seed 1000003 --perception')
    assert '--controller' not in command
    runs.facts['controller'] = 'mine.py:steer'
    assert '--controller mine.py:steer' in confirming(runs, cause, tmp_path)


def test_given_parts_when_written_as_json_then_they_are_read_back():
    assert tuple(part_of(part.to_json()) for part in PARTS) == PARTS

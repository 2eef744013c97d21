"""The text of a report: sections, facts, commands and links of a template, and its numbers."""

from __future__ import annotations

import pytest
from jinja2 import UndefinedError
from report_examples import picture, run_table

from taxinet_ros.analysis.report.parts import Link
from taxinet_ros.analysis.report.text import environment, fill_report, sentences

TEMPLATE = """\
# A {{ kind }} report
- network: {{ kind }}: mine
- seed: {{ seed }}
{% block most %}
Of {{ number | count }} runs
{{ 'most' if number > 2 }} fail.

{% if number > 3 %}
It is known.
{% endif %}
{% endblock %}
## rates: Rates
Half of them.
$ taxinet run 'a  b' --out c
[the analysis](analyze/report.html)
## nothing: Nothing
{% if False %}Not said.{% endif %}
## pictures: Pictures
## tables: A table without rows
"""


@pytest.fixture
def template(tmp_path):
    path = tmp_path / 'page.j2'
    path.write_text(TEMPLATE)
    return path


def test_a_template_becomes_title_facts_summary_and_the_sections_in_which_something_is(template):
    report = fill_report(
        template, {'kind': 'plain', 'seed': '', 'number': 4000},
        {'pictures': (picture(),), 'rates': (run_table(),), 'tables': (run_table(0),)}, worst='r',
    )
    assert (report.title, report.facts) == ('A plain report', {'network': 'plain: mine'})
    assert report.summary == ('Of 4,000 runs most fail.', 'It is known.')
    assert report.worst == 'r'
    rates, pictures, _ = report.sections
    assert (rates.name, rates.heading, rates.sentences) == ('rates', 'Rates', ('Half of them.',))
    assert rates.commands == ("taxinet run 'a  b' --out c",), 'its words are kept as they are'
    assert rates.links == (Link(words='the analysis', path='analyze/report.html'),)
    assert [table.name for table in rates.tables] == ['runs']
    assert [one.name for one in pictures.pictures] == ['curve']
    assert sentences(template, 'most', number=3) == ('Of 3 runs most fail.',)


def test_a_name_that_looks_like_a_command_or_a_link_is_not_lost(tmp_path):
    path = tmp_path / 'page.j2'
    path.write_text('# A page\n\n{{ name }} fails.\n\n## part: A part\n{{ name }} passes.\n')
    for name in ('[mine]', '$ mine', '# mine', 'a: b'):
        report = fill_report(path, {'name': name}, {})
        assert report.title == 'A page'
        assert report.summary == (f'{name} fails.',)


def test_an_unknown_name_or_a_figure_without_its_section_is_an_error(template):
    with pytest.raises(UndefinedError, match='seed'):
        fill_report(template, {'kind': 'plain', 'number': 1}, {})
    with pytest.raises(ValueError, match='no section somewhere'):
        fill_report(
            template, {'kind': 'plain', 'seed': 1, 'number': 1}, {'somewhere': (picture(),)})


@pytest.mark.parametrize(('text', 'shown'), [
    ('{{ 4000 | count }}', '4,000'), ("{{ 1 | many('run') }}", '1 run'),
    ("{{ 4000 | many('run') }}", '4,000 runs'), ('{{ 0.5 | percent }}', '50.0 %'),
    ('{{ -0.128 | percent(0) }}', '−13 %'), ('{{ 0.02 | points }}', '+2.0'),
    ('{{ -1.304 | signed }}', '−1.30'), ('{{ 0.0004 | p }}', 'p < 0.001'),
    ('{{ 0.02 | p }}', 'p = 0.020'), ("{{ 'a B' | capital }}", 'A B'),
])
def test_numbers_have_a_true_minus_and_thousands_apart(tmp_path, text, shown):
    assert environment(tmp_path).from_string(text).render() == shown

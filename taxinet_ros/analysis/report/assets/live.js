// The live page: asks for the runs that have ended since, while somebody looks.

const EVERY_MS = 2000;
const MOST_FAILURES = 200;
const TICKS = 5;
const FRAME = { left: 84, right: 704, top: 32, bottom: 310 };
const CLOCK = 'time_of_day_h';
const PREFERRED = [CLOCK, 'distance_m', 'cross_track_m', 'heading_deg', 'rain_percent'];

const byId = (id) => document.getElementById(id);
const points = [];
let fields = [];
let have = 0;
let silent = false;
let over = false;
/** By this word the command knows which pages have its last figures. */
const me = Math.random().toString(36).slice(2);

/** A value of a scenario as the reports write it: clock times, groups of digits, a true minus. */
function valueWords(field, value) {
  if (field.key === CLOCK) {
    const minutes = Math.round(value * 60);
    const part = (number) => String(number).padStart(2, '0');
    return `${part(Math.floor(minutes / 60))}:${part(minutes % 60)}`;
  }
  return value.toLocaleString('en', { maximumFractionDigits: 2 }).replace('-', '−');
}

function axisWords(field) {
  return field.unit && field.key !== CLOCK ? `${field.title} [${field.unit}]` : field.title;
}

/** Fields with more than one value, the most varied first. */
function variedFields() {
  const varied = fields.map((field, place) => ({
    field, place, count: new Set(points.map((point) => point.values[place])).size,
  })).filter(({ count }) => count > 1);
  const rank = ({ field }) => (PREFERRED.indexOf(field.key) + 1) || PREFERRED.length + 1;
  return varied.sort((a, b) => b.count - a.count || rank(a) - rank(b));
}

/** Fill a choice of fields; what the reader chose stays chosen. */
function offer(select, varied, usual) {
  const before = select.dataset.touched ? select.value : varied[usual]?.field.key;
  const keys = varied.map(({ field }) => field.key).join();
  if (select.dataset.keys !== keys) {
    select.replaceChildren(...varied.map(({ field }) => make('option', { value: field.key }, axisWords(field))));
    select.dataset.keys = keys;
  }
  if (before !== undefined) select.value = before;
}

/** Round numbers between two ends. */
function ticks(field, low, high) {
  const step = 10 ** Math.floor(Math.log10((high - low) / TICKS));
  const steps = field.key === CLOCK ? [0.25, 0.5, 1, 2, 3, 6] : [1, 2, 5, 10].map((one) => one * step);
  const width = steps.find((one) => (high - low) / one <= TICKS + 1) ?? steps[steps.length - 1];
  const found = [];
  for (let number = Math.ceil(low / width); number * width <= high; number += 1) found.push(number * width);
  return found;
}

function scaleOf(values, from, to) {
  const [low, high] = values.reduce(([a, b], value) => [Math.min(a, value), Math.max(b, value)], [Infinity, -Infinity]);
  const room = 0.03 * (to - from);
  const place = (value) => from + room + ((value - low) / (high - low)) * (to - from - 2 * room);
  return { low, high, place };
}

function drawMap() {
  const varied = variedFields();
  offer(byId('across'), varied, 0);
  offer(byId('up'), varied, 1);
  const chosen = ['across', 'up'].map((id) => fields.findIndex(({ key }) => key === byId(id).value));
  const known = points.filter(({ values }) => chosen.every((place) => place >= 0 && values[place] !== null));
  const [across, up] = chosen;
  const several = (place) => new Set(known.map(({ values }) => values[place])).size > 1;
  if (!several(across) || !several(up)) {
    byId('map').replaceChildren();
    return;
  }
  const x = scaleOf(known.map(({ values }) => values[across]), FRAME.left, FRAME.right);
  const y = scaleOf(known.map(({ values }) => values[up]), FRAME.bottom, FRAME.top);
  const parts = [];
  for (const tick of ticks(fields[across], x.low, x.high)) {
    const place = x.place(tick);
    parts.push(makeSvg('line', { class: 'grid', x1: place, x2: place, y1: FRAME.top, y2: FRAME.bottom }));
    parts.push(makeSvg('text', { class: 'label-middle', x: place, y: FRAME.bottom + 22 }, valueWords(fields[across], tick)));
  }
  for (const tick of ticks(fields[up], y.low, y.high)) {
    const place = y.place(tick);
    parts.push(makeSvg('line', { class: 'grid', x1: FRAME.left, x2: FRAME.right, y1: place, y2: place }));
    parts.push(makeSvg('text', { class: 'label-end', x: FRAME.left - 8, y: place + 4 }, valueWords(fields[up], tick)));
  }
  parts.push(makeSvg('line', { class: 'axis', x1: FRAME.left, x2: FRAME.right, y1: FRAME.bottom, y2: FRAME.bottom }));
  parts.push(makeSvg('line', { class: 'axis', x1: FRAME.left, x2: FRAME.left, y1: FRAME.top, y2: FRAME.bottom }));
  parts.push(makeSvg('text', { x: 4, y: FRAME.top - 10 }, axisWords(fields[up])));
  parts.push(makeSvg('text', { class: 'label-middle', x: (FRAME.left + FRAME.right) / 2, y: FRAME.bottom + 48 }, axisWords(fields[across])));
  for (const point of [...known].sort((a, b) => Number(a.failed) - Number(b.failed))) {
    parts.push(mark(point, x.place(point.values[across]), y.place(point.values[up])));
  }
  byId('map').replaceChildren(...parts);
  byId('map').setAttribute('aria-label', `Map of the search: ${axisWords(fields[across])} across, ${axisWords(fields[up])} up; ${known.length} runs`);
}

/** A run: its shape tells the outcome, its size how far below 0 the robustness is. */
function mark(point, x, y) {
  const size = point.failed ? 3 + Math.min(5, Math.log2(1 + Math.abs(point.rho ?? 0))) : 3;
  const title = makeSvg('title', {}, `run ${point.index}, ρ ${point.rho === null ? '–' : signed(point.rho)}: ${point.scene}`);
  return point.failed
    ? makeSvg('rect', { class: 'fail', x: x - size, y: y - size, width: 2 * size, height: 2 * size }, title)
    : makeSvg('circle', { class: 'pass', cx: x, cy: y, r: size }, title);
}

function failureRow(row) {
  const cells = [
    make('td', {}, String(row.index)),
    make('td', { className: 'number' }, row.rho === null ? '–' : signed(row.rho)),
    make('td', {}, make('b', { className: 'outcome outcome-fail' }, row.outcome)),
    make('td', {}, row.detail || row.scene),
  ];
  return make('tr', {}, ...cells);
}

function take(values) {
  fields = values.fields;
  for (const row of values.rows) {
    if (row.outcome === 'PASS' || row.outcome === 'FAIL') points.push({ ...row, failed: row.outcome === 'FAIL' });
    if (row.outcome !== 'PASS') byId('failures').prepend(failureRow(row));
  }
  while (byId('failures').children.length > MOST_FAILURES) byId('failures').lastElementChild.remove();
  byId('none').hidden = byId('failures').children.length > 0;
  const count = (number) => number.toLocaleString('en');
  byId('state').textContent = `${count(values.done)} of at most ${count(values.runs)} runs have ended.`;
  over = values.ended !== '';
  if (over) byId('state').textContent += ` The campaign ${values.ended}. This page is closed, and keeps its last figures.`;
  byId('bar').max = values.runs;
  byId('bar').value = values.done;
  byId('failed').textContent = `${count(values.failed)} of ${count(values.judged)} judged`;
  byId('failing').textContent = values.failing || '–';
  byId('off').textContent = values.off_runway || '–';
  byId('lowest').textContent = values.lowest === null ? '–' : signed(values.lowest);
  byId('broken').textContent = count(values.without_verdict);
  const isNew = values.rows.length > 0;
  have = values.done;
  if (isNew) drawMap();
}

async function ask() {
  if (!document.hidden) {
    try {
      const answer = await fetch(`${document.body.dataset.values}?after=${have}&page=${me}`, { cache: 'no-store' });
      if (!answer.ok) throw new Error(String(answer.status));
      take(await answer.json());
      silent = false;
    } catch {
      if (!silent) byId('state').textContent += ' The command no longer answers: it has ended, or was interrupted. The figures are the last that it told.';
      silent = true;
    }
  }
  if (!over) setTimeout(ask, EVERY_MS);
}

startThemeButton(byId('theme'));
for (const id of ['across', 'up']) {
  byId(id).addEventListener('change', (event) => {
    event.target.dataset.touched = 'yes';
    drawMap();
  });
}
document.addEventListener('visibilitychange', () => { if (!document.hidden && !silent) drawMap(); });
ask();

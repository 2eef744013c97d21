// Curves over one time axis, with one cursor through all of them.

const GUTTER = 46;
const PLOT_HEIGHT = 92;
const AXIS_HEIGHT = 20;

/**
 * What is drawn of a run: curves by class; the band that is tolerated; the least range; by how much
 * a value jumps where an angle has gone once round.
 */
function plotPlan(run, tolerance) {
  const pair = (name) => [['truth', run[name]], ['estimate', run[`${name}Estimate`]]];
  return [
    { title: 'cross-track error [m]', lines: pair('cte'), band: tolerance, least: 2 },
    { title: 'heading error [°]', lines: pair('he'), least: 5, turn: 180 },
    { title: 'steering [°]', lines: [['command', run.steering]], least: 5 },
    ...run.signals.map(({ name, unit, values }) => ({
      title: unit ? `${name} [${unit}]` : name, lines: [['truth', values]], least: 1,
    })),
    ...run.formulas.map(({ name, lower, upper }) => ({
      title: `robustness of ${name}`, lines: [['lower', lower], ['upper', upper]], least: 0.5,
      isInterval: true,
    })),
  ];
}

/** Least and largest finite value of a plot's curves, with a margin, zero always within. */
function valueRange(plan) {
  let [low, high] = [-plan.least, plan.least];
  for (const value of plan.lines.flatMap(([, values]) => values)) {
    if (Number.isFinite(value)) [low, high] = [Math.min(low, value), Math.max(high, value)];
  }
  const margin = 0.06 * (high - low);
  return [low - margin, high + margin];
}

/** SVG path through the values that are known; unknown ones and jumps interrupt it. */
function curve(values, toX, toY, jump = Infinity) {
  return values.map((value, step) => {
    if (Number.isNaN(value)) return '';
    const isJoined = step > 0 && !(Math.abs(value - values[step - 1]) > jump)
      && !Number.isNaN(values[step - 1]);
    return `${isJoined ? 'L' : 'M'}${toX(step)} ${toY(value)}`;
  }).join('');
}

/** Outline of the area between two curves, where both are known. */
function area(lower, upper, toX, toY) {
  const isKnown = (step) => !Number.isNaN(lower[step]) && !Number.isNaN(upper[step]);
  const steps = lower.map((_, step) => step).filter(isKnown);
  const edge = (values, order) => order.map((step) => `${toX(step)} ${toY(values[step])}`).join('L');
  return steps.length ? `M${edge(upper, steps)}L${edge(lower, [...steps].reverse())}Z` : '';
}

class Plots {
  /** `onPick` is called with the step that a person points at. */
  constructor(root, onPick) {
    this.root = root;
    this.cursor = make('div', { className: 'cursor' });
    this.step = 0;
    root.addEventListener('pointerdown', (event) => {
      if (!this.times) return;
      root.setPointerCapture(event.pointerId);
      onPick(this.stepAt(event));
    });
    root.addEventListener('pointermove', (event) => {
      if (root.hasPointerCapture(event.pointerId)) onPick(this.stepAt(event));
    });
    new ResizeObserver(() => { if (this.times) this.draw(); }).observe(root);
  }

  load(run, tolerance) {
    this.times = run.t;
    this.plans = plotPlan(run, tolerance);
    this.outputs = [];
    this.frames = this.plans.map((plan) => makeSvg('svg', {
      class: 'plot', role: 'img', 'aria-label': `${plan.title} over time`,
    }));
    const boxes = this.plans.map((plan, place) => (
      make('div', { className: 'plot-box' }, this.head(plan), this.frames[place])
    ));
    this.axis = makeSvg('svg', { class: 'time-axis', role: 'img', 'aria-label': 'time [s]' });
    this.root.replaceChildren(...boxes, this.axis, this.cursor);
    this.draw();
  }

  /** Title of a plot, and what its curves are worth at the cursor. */
  head(plan) {
    const values = plan.lines.map(([name, line]) => {
      const output = make('output', {}, '');
      this.outputs.push([output, line]);
      const words = plan.lines.length > 1 ? `${name} ` : '';
      return make('span', { className: `key key-${name}` }, words, output);
    });
    return make('div', { className: 'plot-head' }, make('b', {}, plan.title), ...values);
  }

  toX(step) {
    const [first, last] = [this.times[0], this.times.at(-1)];
    const share = last > first ? (this.times[step] - first) / (last - first) : 0;
    return GUTTER + share * (this.width - GUTTER - 1);
  }

  stepAt(event) {
    const share = (event.clientX - this.root.getBoundingClientRect().left - GUTTER)
      / (this.width - GUTTER - 1);
    const time = this.times[0] + share * (this.times.at(-1) - this.times[0]);
    const distances = this.times.map((other) => Math.abs(other - time));
    return distances.indexOf(Math.min(...distances));
  }

  draw() {
    this.width = Math.max(this.root.clientWidth, 2 * GUTTER);
    this.frames.forEach((svg, place) => this.drawPlot(svg, this.plans[place]));
    this.drawAxis();
    this.show(this.step);
  }

  size(svg, height) {
    svg.setAttribute('viewBox', `0 0 ${this.width} ${height}`);
    svg.setAttribute('height', height);
  }

  drawPlot(svg, plan) {
    this.size(svg, PLOT_HEIGHT);
    const [low, high] = valueRange(plan);
    const level = (value) => PLOT_HEIGHT * (1 - (value - low) / (high - low));
    // An infinite end leaves the plot just beyond its edge.
    const toY = (value) => clamp(level(value), -9, PLOT_HEIGHT + 9).toFixed(1);
    const toX = (step) => this.toX(step).toFixed(1);
    const shapes = plan.lines.map(([name, values]) => (
      makeSvg('path', { class: `curve curve-${name}`, d: curve(values, toX, toY, plan.turn) })
    ));
    if (plan.isInterval) {
      const [[, lower], [, upper]] = plan.lines;
      shapes.unshift(makeSvg('path', { class: 'interval', d: area(lower, upper, toX, toY) }));
    }
    svg.replaceChildren(...this.backdrop(plan, low, high, level), ...shapes.reverse());
  }

  /** Ground, tolerated band, level lines and their numbers. */
  backdrop(plan, low, high, level) {
    const ground = { x: GUTTER, width: this.width - GUTTER };
    const shapes = [makeSvg('rect', { class: 'plot-ground', y: 0, height: PLOT_HEIGHT, ...ground })];
    if (plan.band) {
      const [top, bottom] = [level(plan.band), level(-plan.band)];
      shapes.push(makeSvg('rect', { class: 'band', y: top, height: bottom - top, ...ground }));
    }
    const step = roundStep(high - low, 5);
    for (let place = Math.ceil(low / step); place * step < high; place += 1) {
      const value = Number((place * step).toPrecision(6));
      const y = level(value);
      shapes.push(makeSvg('line', {
        class: value === 0 ? 'zero' : 'grid', x1: GUTTER, x2: this.width, y1: y, y2: y,
      }));
      if (y > 6 && y < PLOT_HEIGHT - 4) {
        shapes.push(makeSvg('text', { x: GUTTER - 6, y: y + 4, class: 'level' }, String(value)));
      }
    }
    return shapes;
  }

  drawAxis() {
    this.size(this.axis, AXIS_HEIGHT);
    const [first, last] = [this.times[0], this.times.at(-1)];
    const step = roundStep(Math.max(last - first, 1), clamp(this.width / 90, 2, 8));
    const marks = [];
    for (let place = Math.ceil(first / step); place * step <= last; place += 1) {
      const time = Number((place * step).toPrecision(6));
      const x = this.toX(0) + ((time - first) / (last - first || 1)) * (this.width - GUTTER - 1);
      const anchor = x > this.width - 24 ? 'end' : 'middle';
      marks.push(makeSvg('text', { x, y: 15, 'text-anchor': anchor }, `${time} s`));
    }
    this.axis.replaceChildren(...marks);
  }

  show(step) {
    this.step = step;
    this.cursor.style.transform = `translateX(${this.toX(step)}px)`;
    for (const [output, values] of this.outputs) output.textContent = signed(values[step]);
  }
}

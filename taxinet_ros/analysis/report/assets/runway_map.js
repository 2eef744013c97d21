// The path on the runway from above, in metres: x to the right, left of the centreline up.

const ASPECT = 3;
const MARGIN = 6;
const NEAR = 40;

/** Corners of a polygon or line as SVG points; SVG counts y downwards. */
function points(corners) {
  return corners.map(([x, y]) => `${x},${-y}`).join(' ');
}

/** A round distance between marks so that `span` has about `count` of them. */
function roundStep(span, count) {
  const raw = span / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  return power * [1, 2, 5, 10].find((factor) => factor * power >= raw);
}

/** Least and largest of some numbers, and a margin more on each side. */
function reach(values, margin) {
  return [Math.min(...values) - margin, Math.max(...values) + margin];
}

function isPlace([x, y]) {
  return Number.isFinite(x) && Number.isFinite(y);
}

class RunwayMap {
  constructor(svg) {
    this.svg = svg;
  }

  load(run, ground) {
    this.path = run.x.map((x, step) => [x, run.y[step]]);
    this.heading = run.yaw ?? run.he;
    this.times = run.t;
    this.holdLines = run.holdLines.map(({ corners, until }) => ({
      corners, until, shape: makeSvg('polygon', { class: 'hold-line', points: points(corners) }),
    }));
    const view = this.viewBox(ground.halfWidth);
    this.svg.setAttribute('viewBox', `${view.x} ${view.y} ${view.width} ${view.height}`);
    this.behind = makeSvg('polyline', { class: 'path-behind' });
    this.aircraft = this.aircraftShape(view.width / 45);
    const [startX, startY] = this.path.find(isPlace) ?? [0, 0];
    this.svg.replaceChildren(
      ...this.groundShapes(ground, view),
      ...this.holdLines.map(({ shape }) => shape),
      ...this.distances(view),
      makeSvg('polyline', { class: 'path-ahead', points: points(this.path.filter(isPlace)) }),
      this.behind,
      makeSvg('circle', { class: 'path-start', cx: startX, cy: -startY, r: view.width / 110 }),
      this.aircraft,
    );
  }

  /** The whole path and the runway's width with a margin, in the shape of the map. */
  viewBox(halfWidth) {
    const path = [[this.path[0]?.[0] || 0, 0], ...this.path].filter(isPlace);
    const isNear = ([x, y]) => path.some(([px, py]) => Math.hypot(x - px, y - py) < NEAR);
    const known = [...path, ...this.holdLines.flatMap(({ corners }) => corners).filter(isNear)];
    const [left, right] = reach(known.map(([x]) => x), MARGIN);
    const [top, bottom] = reach([-halfWidth, halfWidth, ...known.map(([, y]) => -y)], MARGIN);
    // The distances stand below the path.
    const lowest = bottom + 0.12 * (bottom - top);
    const width = Math.max(right - left, ASPECT * (lowest - top));
    const height = width / ASPECT;
    return { x: (left + right - width) / 2, y: (top + lowest - height) / 2, width, height };
  }

  groundShapes(ground, view) {
    const polygon = (kind) => (corners) => (
      makeSvg('polygon', { class: kind, points: points(corners) })
    );
    const isSeen = (corners) => {
      const [first, last] = reach(corners.map(([x]) => x), 0);
      return last > view.x && first < view.x + view.width;
    };
    const { length, tolerance, track } = ground;
    const band = { x: 0, y: -tolerance, width: length, height: 2 * tolerance };
    const line = (corners) => makeSvg('polyline', { class: 'taxi-line', points: points(corners) });
    return [
      ...(track ? [polygon('pavement')(track.pavement)] : []),
      ...ground.pavement.map(polygon('pavement')),
      track ? polygon('band')(track.band) : makeSvg('rect', { class: 'band', ...band }),
      ...ground.paint.filter(isSeen).map(polygon('paint')),
      ...(track ? track.lines.map(line) : []),
    ];
  }

  /** Marks along the lower edge: metres past the threshold. */
  distances(view) {
    const step = roundStep(view.width, 6);
    const size = view.width / 42;
    const y = view.y + view.height - size / 2;
    const marks = [];
    const last = view.x + view.width - 2 * size;
    for (let x = Math.ceil((view.x + 2 * size) / step) * step; x < last; x += step) {
      marks.push(makeSvg('text', { x, y, 'font-size': size }, `${x} m`));
    }
    return marks;
  }

  aircraftShape(size) {
    const outline = [[1.6, 0], [-1, 0.9], [-0.5, 0], [-1, -0.9]];
    const corners = outline.map(([x, y]) => [x * size, y * size]);
    return makeSvg('polygon', { class: 'aircraft', points: points(corners) });
  }

  show(step) {
    const [x, y] = this.path[step];
    for (const { shape, until } of this.holdLines) {
      shape.classList.toggle('cleared', this.times[step] >= until);
    }
    this.behind.setAttribute('points', points(this.path.slice(0, step + 1).filter(isPlace)));
    const isKnown = isPlace([x, y]);
    this.aircraft.setAttribute('visibility', isKnown ? 'visible' : 'hidden');
    const turn = -this.heading[step] || 0;
    if (isKnown) this.aircraft.setAttribute('transform', `translate(${x} ${-y}) rotate(${turn})`);
  }
}

// The dialog that shows one run step by step. The page's address says which: #run=<id>.

const RUN_PREFIX = '#run=';
const CURVES = ['t', 'x', 'y', 'speed', 'cte', 'cteEstimate', 'he', 'heEstimate', 'steering'];

function runLink(id) {
  return RUN_PREFIX + encodeURIComponent(id);
}

/** The run that the page's address names, or null. */
function addressedRun() {
  if (!location.hash.startsWith(RUN_PREFIX)) return null;
  try {
    return decodeURIComponent(location.hash.slice(RUN_PREFIX.length));
  } catch {
    return null;
  }
}

/** A run's data block with numbers throughout. */
function readRun(number) {
  const run = readBlock(document.getElementById(`run-data-${number}`));
  for (const name of CURVES) run[name] = run[name].map(toNumber);
  for (const signal of run.signals) signal.values = signal.values.map(toNumber);
  for (const line of run.holdLines) line.until = toNumber(line.until);
  for (const formula of run.formulas) {
    formula.lower = formula.lower.map(toNumber);
    formula.upper = formula.upper.map(toNumber);
  }
  return run;
}

class Viewer {
  constructor(dialog) {
    this.dialog = dialog;
    this.part = (name) => dialog.querySelector(`#viewer-${name}`);
    this.ids = readBlock(document.getElementById('run-ids'));
    this.grounds = readBlock(document.getElementById('grounds'));
    this.camera = new Camera(this.part('camera'), this.part('no-frames'));
    this.map = new RunwayMap(this.part('map'));
    this.player = new Player((step) => this.show(step), (playing) => this.showPlaying(playing));
    this.plots = new Plots(this.part('plots'), (step) => this.player.seek(step));
    this.wasOpenedHere = false;
    this.listen();
    this.follow();
  }

  listen() {
    const on = (name, type, action) => this.part(name).addEventListener(type, action);
    on('play', 'click', () => this.player.toggle());
    on('scrubber', 'input', (event) => this.player.seek(Number(event.target.value)));
    on('speed', 'change', (event) => { this.player.speed = Number(event.target.value); });
    on('before', 'click', () => this.goTo(this.number - 1));
    on('after', 'click', () => this.goTo(this.number + 1));
    on('close', 'click', () => this.dialog.close());
    this.dialog.addEventListener('keydown', (event) => this.onKey(event));
    this.dialog.addEventListener('close', () => this.leave());
    document.addEventListener('click', (event) => {
      const link = event.target.closest?.(`a[href^="${RUN_PREFIX}"]`);
      if (link) this.wasOpenedHere = true;
    });
    addEventListener('hashchange', () => this.follow());
  }

  /** Open, change or close as the address says. */
  follow() {
    const number = this.ids.indexOf(addressedRun());
    if (number >= 0) this.open(number);
    else if (this.dialog.open) this.dialog.close();
  }

  open(number) {
    this.number = number;
    this.run = readRun(number);
    if (!this.dialog.open) this.dialog.showModal();
    this.showHead();
    const ground = this.grounds[this.run.ground];
    this.camera.load(this.run.frames);
    this.map.load(this.run, ground);
    this.plots.step = 0;
    this.plots.load(this.run, ground.tolerance);
    this.part('scrubber').max = this.run.t.length - 1;
    this.player.load(this.run.t);
    this.part('play').focus();
  }

  /** After closing, take the run out of the address: one step back, if it was one step hither. */
  leave() {
    this.player.pause();
    if (addressedRun() === null) return;
    if (this.wasOpenedHere) history.back();
    else history.replaceState(null, '', location.pathname + location.search);
    this.wasOpenedHere = false;
  }

  /** Another run takes the place of this one, so that going back leads to the page. */
  goTo(number) {
    if (number in this.ids) location.replace(runLink(this.ids[number]));
  }

  showHead() {
    this.part('title').textContent = this.run.id;
    const outcome = this.part('outcome');
    outcome.textContent = this.run.outcome;
    outcome.className = `outcome outcome-${this.run.outcome.toLowerCase()}`;
    this.part('place').textContent = `${this.number + 1} of ${this.ids.length}`;
    this.part('before').disabled = this.number === 0;
    this.part('after').disabled = this.number === this.ids.length - 1;
    this.part('facts').replaceChildren(...this.run.facts.map(([name, value]) => (
      make('div', {}, make('dt', {}, name), make('dd', {}, value))
    )));
  }

  show(step) {
    const frame = this.camera.show(step);
    this.map.show(step);
    this.plots.show(step);
    const scrubber = this.part('scrubber');
    scrubber.value = step;
    const words = this.words(step, frame);
    scrubber.setAttribute('aria-valuetext', words[0]);
    this.part('readout').textContent = words.join(' · ');
  }

  words(step, frame) {
    const { t, x, speed, frames } = this.run;
    const isMoving = Number.isFinite(speed[step]) && Number.isFinite(x[step]);
    return [
      `${t[step].toFixed(1)} s`,
      `step ${step} of ${t.length - 1}`,
      frames.steps.length && `frame ${frame + 1} of ${frames.steps.length}`,
      isMoving && `${speed[step].toFixed(1)} m/s at ${x[step].toFixed(0)} m`,
    ].filter(Boolean);
  }

  showPlaying(playing) {
    const button = this.part('play');
    button.textContent = playing ? '❚❚' : '▶';
    button.setAttribute('aria-label', playing ? 'Pause' : 'Play');
  }

  onKey(event) {
    if (event.altKey || event.ctrlKey || event.metaKey) return;
    const isOnButton = event.target.closest('button') !== null;
    if (event.target.tagName === 'SELECT' || (event.key === ' ' && isOnButton)) return;
    const action = this.actionOf(event);
    if (!action) return;
    event.preventDefault();
    action();
  }

  actionOf({ key, shiftKey }) {
    const { player } = this;
    const stride = shiftKey ? Math.max(player.stepAt(player.times[0] + 1), 1) : 1;
    return {
      ' ': () => player.toggle(),
      ArrowLeft: () => player.seek(player.step - stride),
      ArrowRight: () => player.seek(player.step + stride),
      Home: () => player.seek(0),
      End: () => player.seek(player.last),
      n: () => this.goTo(this.number + 1),
      p: () => this.goTo(this.number - 1),
    }[key.length > 1 ? key : key.toLowerCase()];
  }
}

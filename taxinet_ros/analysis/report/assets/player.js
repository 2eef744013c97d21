// The clock of the viewer: which control step is shown, and how it goes on while playing.

class Player {
  /** `onStep` is called with each new step, `onPlaying` with whether it plays. */
  constructor(onStep, onPlaying) {
    this.onStep = onStep;
    this.onPlaying = onPlaying;
    this.times = [0];
    this.step = 0;
    this.speed = 1;
    this.request = 0;
  }

  get last() {
    return this.times.length - 1;
  }

  get playing() {
    return this.request !== 0;
  }

  /** Take up a run with these times [s], at its start. */
  load(times) {
    this.pause();
    this.times = times;
    this.seek(0);
  }

  seek(step) {
    this.step = clamp(step, 0, this.last);
    this.elapsed = this.times[this.step];
    this.onStep(this.step);
  }

  /** The step that belongs to a time [s], the one before it where there is none. */
  stepAt(time) {
    const after = this.times.findIndex((other) => other > time);
    return after < 0 ? this.last : Math.max(after - 1, 0);
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  play() {
    if (this.step === this.last) this.seek(0);
    let before = performance.now();
    const advance = (now) => {
      this.elapsed += (this.speed * Math.max(now - before, 0)) / 1000;
      before = now;
      const step = this.stepAt(this.elapsed);
      if (step !== this.step) {
        this.step = step;
        this.onStep(step);
      }
      if (step === this.last) this.pause();
      else this.request = requestAnimationFrame(advance);
    };
    this.request = requestAnimationFrame(advance);
    this.onPlaying(true);
  }

  pause() {
    cancelAnimationFrame(this.request);
    this.request = 0;
    this.onPlaying(false);
  }
}

// What the camera saw: the newest frame at or before the step that is shown.

class Camera {
  constructor(canvas, note) {
    this.canvas = canvas;
    this.note = note;
    this.steps = [];
  }

  load(frames) {
    this.steps = frames.steps;
    this.images = frames.webp.map((data) => {
      const image = new Image();
      image.src = `data:image/webp;base64,${data}`;
      return image;
    });
    this.shown = null;
    this.canvas.hidden = this.steps.length === 0;
    this.note.hidden = !frames.missing;
    this.note.textContent = `Camera frames are missing: ${frames.missing}`;
  }

  /** Number of the frame that belongs to a step; -1 where there is none yet. */
  frameAt(step) {
    const after = this.steps.findIndex((other) => other > step);
    return (after < 0 ? this.steps.length : after) - 1;
  }

  /** Show a step and return the number of its frame. */
  show(step) {
    const number = this.frameAt(step);
    if (number >= 0) this.draw(this.images[number]);
    return number;
  }

  draw(image) {
    this.shown = image;
    if (image.complete) {
      this.canvas.width = image.naturalWidth;
      this.canvas.height = image.naturalHeight;
      this.canvas.getContext('2d').drawImage(image, 0, 0);
    } else {
      image.onload = () => { if (this.shown === image) this.draw(image); };
    }
  }
}

// Shows a picture with zoom and pan: mouse, touch and keys.

const MIN_SCALE = 1 / 32, MAX_SCALE = 64;

export class Viewer {
  // canvas: where; onView(): after every change of the zoom; onPixel(pixel or null): the pixel [x, y] of the image
  constructor(canvas, onView, onPixel) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.onView = onView;
    this.onPixel = onPixel;
    this.buffer = document.createElement("canvas");
    this.size = null; // of the image, in pixels
    this.reduction = 1;
    this.isFitted = true;
    this.scale = 1; // CSS pixels per pixel of the image
    this.left = this.top = 0;
    this.pointers = new Map();
    new ResizeObserver(() => this.resize()).observe(canvas.parentElement);
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    for (const name of ["pointerdown", "pointermove", "pointerup", "pointercancel", "pointerleave"])
      canvas.addEventListener(name, (event) => this.pointer(event));
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  // Pixels of the image, in either direction, that a device pixel shows.
  get wantedReduction() {
    return Math.min(Math.max(Math.round(1 / (this.scale * devicePixelRatio)), 1), 16);
  }

  setSize(width, height) {
    this.size = [width, height];
    this.resize();
  }

  // RGBA of a picture with a pixel for reduction x reduction pixels of the image.
  show(rgba, width, height, reduction) {
    this.buffer.width = width;
    this.buffer.height = height;
    this.reduction = reduction;
    const data = new ImageData(new Uint8ClampedArray(rgba.buffer), width, height);
    this.buffer.getContext("2d").putImageData(data, 0, 0);
    this.hasPicture = true;
    this.draw();
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas.parentElement;
    this.canvas.width = Math.round(clientWidth * devicePixelRatio);
    this.canvas.height = Math.round(clientHeight * devicePixelRatio);
    if (this.isFitted) this.fit();
    else this.draw();
  }

  fit() {
    if (!this.size) return;
    const { clientWidth, clientHeight } = this.canvas;
    this.isFitted = true;
    this.scale = Math.min(clientWidth / this.size[0], clientHeight / this.size[1], MAX_SCALE);
    this.left = (clientWidth - this.scale * this.size[0]) / 2;
    this.top = (clientHeight - this.scale * this.size[1]) / 2;
    this.changed();
  }

  // Zoom to a scale so that the point (x, y) of the canvas stays; without it the centre.
  zoomTo(scale, x = this.canvas.clientWidth / 2, y = this.canvas.clientHeight / 2) {
    scale = Math.min(Math.max(scale, MIN_SCALE), MAX_SCALE);
    this.left = x - ((x - this.left) * scale) / this.scale;
    this.top = y - ((y - this.top) * scale) / this.scale;
    this.scale = scale;
    this.isFitted = false;
    this.changed();
  }

  move(x, y) {
    this.left += x;
    this.top += y;
    this.isFitted = false;
    this.changed();
  }

  changed() {
    if (this.size) { // a part of the image stays visible
      const { clientWidth, clientHeight } = this.canvas, edge = 40;
      this.left = Math.min(Math.max(this.left, edge - this.scale * this.size[0]), clientWidth - edge);
      this.top = Math.min(Math.max(this.top, edge - this.scale * this.size[1]), clientHeight - edge);
    }
    this.draw();
    this.onView();
  }

  draw() {
    const ratio = devicePixelRatio, step = this.scale * this.reduction * ratio;
    this.context.setTransform(1, 0, 0, 1, 0, 0);
    this.context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    if (!this.hasPicture) return;
    this.context.imageSmoothingEnabled = step < 1.5;
    this.context.imageSmoothingQuality = "high";
    const { width, height } = this.buffer, left = Math.round(this.left * ratio), top = Math.round(this.top * ratio);
    this.context.drawImage(this.buffer, left, top, width * step, height * step);
  }

  pixelAt(event) {
    const box = this.canvas.getBoundingClientRect();
    const x = Math.floor((event.clientX - box.left - this.left) / this.scale);
    const y = Math.floor((event.clientY - box.top - this.top) / this.scale);
    const isInside = this.size && x >= 0 && y >= 0 && x < this.size[0] && y < this.size[1];
    return isInside ? [x, y] : null;
  }

  wheel(event) {
    event.preventDefault();
    const box = this.canvas.getBoundingClientRect();
    const factor = Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015));
    this.zoomTo(this.scale * factor, event.clientX - box.left, event.clientY - box.top);
  }

  pointer(event) {
    const last = this.pointers.get(event.pointerId), now = [event.clientX, event.clientY];
    if (event.type === "pointerdown") {
      this.canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, now);
    } else if (event.type === "pointermove") {
      if (last) this.drag(event.pointerId, last, now);
    } else {
      this.pointers.delete(event.pointerId);
    }
    this.onPixel(event.type === "pointerleave" ? null : this.pixelAt(event));
  }

  drag(id, last, now) {
    const other = [...this.pointers].find(([key]) => key !== id)?.[1];
    this.pointers.set(id, now);
    if (!other) {
      this.move(now[0] - last[0], now[1] - last[1]);
      return;
    }
    const distance = (point) => Math.hypot(point[0] - other[0], point[1] - other[1]);
    const box = this.canvas.getBoundingClientRect();
    const middle = [(now[0] + other[0]) / 2 - box.left, (now[1] + other[1]) / 2 - box.top];
    this.move((now[0] - last[0]) / 2, (now[1] - last[1]) / 2);
    this.zoomTo((this.scale * distance(now)) / Math.max(distance(last), 1), ...middle);
  }

  key(event) {
    const actions = {
      "+": () => this.zoomTo(this.scale * 1.25), "=": () => this.zoomTo(this.scale * 1.25),
      "-": () => this.zoomTo(this.scale / 1.25), 0: () => this.fit(), 1: () => this.zoomTo(1 / devicePixelRatio),
      ArrowLeft: () => this.move(40, 0), ArrowRight: () => this.move(-40, 0),
      ArrowUp: () => this.move(0, 40), ArrowDown: () => this.move(0, -40),
    };
    const action = event.ctrlKey || event.metaKey || event.altKey ? null : actions[event.key];
    if (!action) return;
    event.preventDefault();
    action();
  }
}

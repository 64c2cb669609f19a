// The image viewer of a scene: two images with a divider, or all side by side, with one zoom, exposure and pixel cursor.
//
// The data of a viewer is the JSON in its script element, made by `viewer_data.py`. Planes of half-floats are deflated; their
// low bytes precede their high bytes.

const MAX_SCALE = 48; // CSS pixels per image pixel
const HALF = halfFloats();

function halfFloats() {
  const values = new Float32Array(65536);
  for (let bits = 0; bits < 65536; bits++) {
    const exponent = (bits >> 10) & 31, mantissa = bits & 1023;
    const size = exponent === 0 ? mantissa * 2 ** -24
      : exponent === 31 ? (mantissa ? NaN : Infinity) : (1 + mantissa / 1024) * 2 ** (exponent - 15);
    values[bits] = bits & 32768 ? -size : size;
  }
  return values;
}

async function decodePlanes(text, count) {
  const bytes = Uint8Array.from(atob(text), letter => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  const raw = new Uint8Array(await new Response(stream).arrayBuffer());
  const planes = new Uint16Array(count);
  for (let k = 0; k < count; k++) planes[k] = raw[k] | raw[count + k] << 8;
  return planes;
}

// The curve of `isonoise.film.png.tone_map`, for every half-float.
function toneTable(exposure) {
  const shoulder = 0.6;
  return Uint8ClampedArray.from(HALF, half => {
    let value = half > 0 ? half * exposure : 0;
    if (value > shoulder) value = shoulder - (1 - shoulder) * Math.expm1(-(value - shoulder) / (1 - shoulder));
    return Math.round(255 * (value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055));
  });
}

// Colours of a logarithmic scale, for every half-float: bytes R, G, B, A as one little-endian number.
function colourTable(scale, factor) {
  const colours = scale.colours.map(hex => {
    const rgb = parseInt(hex.slice(1), 16);
    return (255 << 24 | (rgb & 255) << 16 | rgb & 0xff00 | rgb >> 16) >>> 0;
  });
  const span = Math.log(scale.high / scale.low), last = colours.length - 1;
  return Uint32Array.from(HALF, half => {
    const position = Math.log(Math.max(Math.abs(half) * factor, scale.low) / scale.low) / span;
    return colours[Math.round(Math.min(position || 0, 1) * last)];
  });
}

class Picture {
  // One image of the viewer: the reference, or a strategy's with its error and samples.
  constructor(entry, data) {
    Object.assign(this, { entry, data, title: entry.title, shown: "" });
    this.canvas = document.createElement("canvas");
    this.canvas.width = data.width;
    this.canvas.height = data.height;
  }

  async decode() {
    const pixels = this.data.width * this.data.height;
    const [rgb, error, samples] = await Promise.all([
      decodePlanes(this.entry.rgb, 3 * pixels),
      this.entry.error && decodePlanes(this.entry.error, pixels),
      this.entry.samples && decodePlanes(this.entry.samples, pixels),
    ]);
    Object.assign(this, { rgb, error, samples });
  }

  // Fills the canvas with a layer: "rgb", "error" or "samples". The reference has only the first.
  paint(layer, exposure) {
    if (!this[layer]) layer = "rgb";
    const key = layer === "rgb" ? `rgb ${exposure}` : layer;
    if (this.shown === key) return;
    this.shown = key;
    const { width, height, scales, tables } = this.data;
    const target = new ImageData(width, height), pixels = width * height;
    if (layer === "rgb") {
      if (tables.exposure !== exposure) Object.assign(tables, { exposure, tone: toneTable(this.data.exposure * 2 ** exposure) });
      for (let k = 0; k < pixels; k++) {
        for (let c = 0; c < 3; c++) target.data[4 * k + c] = tables.tone[this.rgb[c * pixels + k]];
        target.data[4 * k + 3] = 255;
      }
    } else {
      const factor = layer === "samples" ? this.entry.samples_factor : 1;
      const key = `${layer} ${factor}`, words = new Uint32Array(target.data.buffer);
      tables[key] ??= colourTable(scales[layer], factor);
      for (let k = 0; k < pixels; k++) words[k] = tables[key][this[layer][k]];
    }
    this.canvas.getContext("2d").putImageData(target, 0, 0);
  }

  // The values of a pixel: R, G, B, and for a strategy error and samples.
  values(x, y) {
    const { width, height } = this.data, pixels = width * height, k = y * width + x;
    return {
      rgb: [0, 1, 2].map(c => HALF[this.rgb[c * pixels + k]]),
      error: this.error ? HALF[this.error[k]] : null,
      samples: this.samples ? HALF[this.samples[k]] * this.entry.samples_factor : null,
    };
  }
}

function number(value, digits = 4) {
  return value !== 0 && (Math.abs(value) < 1e-3 || Math.abs(value) >= 1e6)
    ? value.toExponential(digits - 1) : String(+value.toPrecision(digits));
}

class Viewer {
  constructor(root) {
    this.root = root;
    this.data = JSON.parse(root.querySelector("script").textContent);
    this.data.tables = {};
    this.pictures = this.data.images.map(entry => new Picture(entry, this.data));
    this.view = { x: 0.5, y: 0.5, zoom: 1 }; // centre as a share of the image; zoom 1 fits the image into a canvas
    this.split = 0.5;
    this.pixel = null;
    this.pointers = new Map();
    this.part = name => root.querySelector(`[data-part="${name}"]`);
    this.all = name => [...root.querySelectorAll(`[data-part="${name}"]`)];
    this.canvases = [this.part("compare"), ...this.all("single")];
    for (const canvas of this.canvases) canvas.style.aspectRatio = `${this.data.width} / ${this.data.height}`;
    this.part("pair").style.maxWidth = `calc(85vh * ${this.data.width / this.data.height})`;
    this.bindControls();
    this.canvases.forEach(canvas => this.bindCanvas(canvas));
    this.bindDivider();
    new ResizeObserver(() => this.draw()).observe(root);
    new IntersectionObserver((entries, observer) => {
      if (!entries.some(entry => entry.isIntersecting)) return;
      observer.disconnect();
      this.load();
    }, { rootMargin: "600px" }).observe(root);
  }

  async load() {
    this.loading ??= Promise.all(this.pictures.map(picture => picture.decode()));
    await this.loading;
    this.isLoaded = true;
    this.root.dataset.state = "ready";
    this.draw();
  }

  bindControls() {
    for (const name of ["left", "right", "exposure"]) this.part(name).addEventListener("input", () => this.draw());
    for (const radio of this.root.querySelectorAll("input[type=radio]")) radio.addEventListener("change", () => this.draw());
    const actions = { in: () => this.zoomBy(1.5), out: () => this.zoomBy(1 / 1.5), fit: () => this.reset(), actual: () => this.actual() };
    for (const [name, action] of Object.entries(actions)) this.part(name).addEventListener("click", action);
  }

  choice(name) {
    return this.root.querySelector(`input[data-part="${name}"]:checked`).value;
  }

  // Canvases that are visible, each with the pictures to the left and right of the divider.
  shown() {
    if (this.choice("layout") === "all") return this.all("single").map((canvas, k) => [canvas, this.pictures[k], this.pictures[k]]);
    return [[this.part("compare"), this.pictures[this.part("left").value], this.pictures[this.part("right").value]]];
  }

  // Scale (CSS pixels per image pixel) and position of the image's corner in a canvas, inside its bounds.
  placement(canvas) {
    const { width, height } = this.data, { clientWidth, clientHeight } = canvas;
    const fit = Math.min(clientWidth / width, clientHeight / height);
    const scale = fit * this.view.zoom;
    const corner = (size, image, centre) => image * scale <= size + 0.5
      ? (size - image * scale) / 2 : Math.min(0, Math.max(size - image * scale, size / 2 - centre * image * scale));
    return { fit, scale, left: corner(clientWidth, width, this.view.x), top: corner(clientHeight, height, this.view.y) };
  }

  draw() {
    const exposure = +this.part("exposure").value, layer = this.choice("layer"), layout = this.choice("layout");
    this.part("exposure-text").textContent = `${exposure > 0 ? "+" : ""}${exposure} EV`;
    this.part("pair").hidden = layout === "all";
    this.part("grid").hidden = layout !== "all";
    for (const name of ["left", "right"]) this.part(name).disabled = layout === "all";
    for (const scale of this.all("scale")) scale.hidden = scale.dataset.layer !== layer;
    if (!this.isLoaded) return;
    for (const [canvas, left, right] of this.shown()) {
      for (const picture of [left, right]) picture.paint(layer, exposure);
      this.drawCanvas(canvas, left, right);
    }
    const divider = this.part("divider");
    divider.style.left = `${100 * this.split}%`;
    divider.setAttribute("aria-valuenow", Math.round(100 * this.split));
    this.showPixel();
  }

  drawCanvas(canvas, left, right) {
    const ratio = window.devicePixelRatio || 1, { clientWidth, clientHeight } = canvas;
    canvas.width = Math.round(clientWidth * ratio);
    canvas.height = Math.round(clientHeight * ratio);
    const context = canvas.getContext("2d"), { width, height } = this.data;
    const { scale, left: x, top: y } = this.placement(canvas);
    const split = left === right ? clientWidth : this.split * clientWidth;
    context.scale(ratio, ratio);
    context.imageSmoothingEnabled = scale * ratio < 1;
    for (const [picture, from, to] of [[left, 0, split], [right, split, clientWidth]]) {
      if (to <= from) continue;
      context.save();
      context.beginPath();
      context.rect(from, 0, to - from, clientHeight);
      context.clip();
      context.drawImage(picture.canvas, x, y, width * scale, height * scale);
      context.restore();
    }
    if (!this.pixel) return;
    const side = Math.max(scale, 7), middle = (at, corner) => corner + (at + 0.5) * scale - side / 2;
    for (const [colour, grow] of [["#000", 1], ["#fff", 0]]) {
      context.strokeStyle = colour;
      context.strokeRect(middle(this.pixel.x, x) - grow, middle(this.pixel.y, y) - grow, side + 2 * grow, side + 2 * grow);
    }
  }

  showPixel(announce = false) {
    if (!this.isLoaded || !this.pixel) return;
    const { x, y } = this.pixel, factor = this.data.factor;
    const place = `pixel ${x * factor}, ${y * factor}`;
    const percent = value => `${this.data.signed && value > 0 ? "+" : ""}${number(100 * value, 3)} %`;
    this.part("pixel").textContent = place;
    const rows = this.pictures.map((picture, k) => {
      const { rgb, error, samples } = picture.values(x, y);
      const cells = this.root.querySelectorAll(`tr[data-image="${k}"] td`);
      const texts = [...rgb.map(value => number(value)), error === null ? "" : percent(error), samples === null ? "" : number(samples)];
      texts.forEach((text, column) => { cells[column].textContent = text; });
      return `${picture.title}: ${error === null ? texts.slice(0, 3).join(" ") : `error ${texts[3]}`}`;
    });
    if (announce) this.part("status").textContent = [place, ...rows].join("; ");
  }

  // The pixel of an event in a canvas, or null outside of the image.
  pixelAt(canvas, event) {
    const box = canvas.getBoundingClientRect(), { scale, left, top } = this.placement(canvas);
    const x = Math.floor((event.clientX - box.left - left) / scale), y = Math.floor((event.clientY - box.top - top) / scale);
    return x >= 0 && y >= 0 && x < this.data.width && y < this.data.height ? { x, y } : null;
  }

  // Zooms by a factor; the point of the canvas at `at` stays where it is, or the centre.
  zoomBy(factor, canvas = this.shown()[0][0], at = null) {
    const { scale, fit, left, top } = this.placement(canvas), { width, height } = this.data;
    const x = at ? at.x : canvas.clientWidth / 2, y = at ? at.y : canvas.clientHeight / 2;
    const zoom = Math.min(Math.max(this.view.zoom * factor, 1), Math.max(MAX_SCALE / fit, 1)), grown = fit * zoom;
    this.view = {
      x: ((x - left) / scale + (canvas.clientWidth / 2 - x) / grown) / width,
      y: ((y - top) / scale + (canvas.clientHeight / 2 - y) / grown) / height,
      zoom,
    };
    this.keepInside(canvas);
  }

  panBy(canvas, dx, dy) {
    const { scale } = this.placement(canvas);
    this.view.x -= dx / scale / this.data.width;
    this.view.y -= dy / scale / this.data.height;
    this.keepInside(canvas);
  }

  // Moves the centre so that no empty border is in view.
  keepInside(canvas) {
    const { scale, left, top } = this.placement(canvas), { width, height } = this.data;
    this.view.x = (canvas.clientWidth / 2 - left) / scale / width;
    this.view.y = (canvas.clientHeight / 2 - top) / scale / height;
    for (const each of this.canvases) each.style.touchAction = this.view.zoom > 1 ? "none" : "pan-y";
    this.draw();
  }

  reset() {
    this.view = { x: 0.5, y: 0.5, zoom: 1 };
    this.keepInside(this.shown()[0][0]);
  }

  actual() {
    this.zoomBy(1 / this.placement(this.shown()[0][0]).scale);
  }

  // Shows a region of the image, in its pixels.
  show({ x, y, width, height }) {
    const data = this.data, canvas = this.shown()[0][0];
    this.view = {
      x: (x + width / 2) / data.factor / data.width,
      y: (y + height / 2) / data.factor / data.height,
      zoom: Math.max(1, 0.9 * data.factor * Math.min(data.width / width, data.height / height)),
    };
    this.keepInside(canvas);
  }

  bindCanvas(canvas) {
    const position = event => ({ x: event.clientX - canvas.getBoundingClientRect().left, y: event.clientY - canvas.getBoundingClientRect().top });
    canvas.addEventListener("pointerdown", event => {
      canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, position(event));
    });
    canvas.addEventListener("pointermove", event => {
      const before = this.pointers.get(event.pointerId), now = position(event);
      if (before) {
        this.pointers.set(event.pointerId, now);
        const other = [...this.pointers].find(([id]) => id !== event.pointerId)?.[1];
        if (other) {
          const distance = point => Math.hypot(point.x - other.x, point.y - other.y) || 1;
          this.zoomBy(distance(now) / distance(before), canvas, { x: (now.x + other.x) / 2, y: (now.y + other.y) / 2 });
          return;
        }
        if (this.view.zoom > 1) this.panBy(canvas, now.x - before.x, now.y - before.y);
      }
      this.pixel = this.pixelAt(canvas, event) ?? this.pixel;
      this.draw();
    });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, event => this.pointers.delete(event.pointerId));
    canvas.addEventListener("click", event => { this.pixel = this.pixelAt(canvas, event) ?? this.pixel; this.draw(); });
    canvas.addEventListener("dblclick", event => this.zoomBy(2, canvas, position(event)));
    canvas.addEventListener("wheel", event => {
      if (!event.ctrlKey && !event.metaKey) return;
      event.preventDefault();
      this.zoomBy(Math.exp(-event.deltaY / 300), canvas, position(event));
    }, { passive: false });
    canvas.addEventListener("keydown", event => this.onKey(event, canvas));
  }

  onKey(event, canvas) {
    const step = event.shiftKey ? 10 : 1;
    const moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
    const number = +event.key;
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (moves[event.key]) this.movePixel(canvas, ...moves[event.key]);
    else if (event.key === "+" || event.key === "=") this.zoomBy(1.5, canvas, this.pixelCentre(canvas));
    else if (event.key === "-") this.zoomBy(1 / 1.5, canvas, this.pixelCentre(canvas));
    else if (event.key === "0") this.reset();
    else if (number >= 1 && number <= this.pictures.length) { this.part("right").value = number - 1; this.draw(); }
    else return;
    event.preventDefault();
  }

  pixelCentre(canvas) {
    const { scale, left, top } = this.placement(canvas);
    return this.pixel && { x: left + (this.pixel.x + 0.5) * scale, y: top + (this.pixel.y + 0.5) * scale };
  }

  // Moves the pixel cursor; the view follows it.
  movePixel(canvas, dx, dy) {
    const { width, height } = this.data, clamp = (value, size) => Math.min(Math.max(value, 0), size - 1);
    const from = this.pixel ?? { x: Math.floor(this.view.x * width), y: Math.floor(this.view.y * height) };
    this.pixel = { x: clamp(from.x + dx, width), y: clamp(from.y + dy, height) };
    const at = this.pixelCentre(canvas);
    const beyond = (value, size) => Math.min(value, 0) + Math.max(value - size, 0);
    this.panBy(canvas, -beyond(at.x, canvas.clientWidth), -beyond(at.y, canvas.clientHeight));
    this.showPixel(true);
  }

  bindDivider() {
    const divider = this.part("divider"), stage = divider.parentNode;
    const move = split => { this.split = Math.min(Math.max(split, 0), 1); this.draw(); };
    divider.addEventListener("pointerdown", event => divider.setPointerCapture(event.pointerId));
    divider.addEventListener("pointermove", event => {
      const box = stage.getBoundingClientRect();
      if (divider.hasPointerCapture(event.pointerId)) move((event.clientX - box.left) / box.width);
    });
    divider.addEventListener("keydown", event => {
      const to = { ArrowLeft: this.split - 0.02, ArrowRight: this.split + 0.02, Home: 0, End: 1 }[event.key];
      if (to === undefined) return;
      event.preventDefault();
      move(to);
    });
  }
}

document.documentElement.classList.add("scripted");
const viewers = new Map([...document.querySelectorAll(".viewer")].map(root => [root.id, new Viewer(root)]));
for (const button of document.querySelectorAll("button[data-viewer]")) button.addEventListener("click", () => {
  const viewer = viewers.get(button.dataset.viewer);
  viewer.show(JSON.parse(button.dataset.region));
  viewer.root.scrollIntoView({ behavior: "smooth", block: "start" });
});

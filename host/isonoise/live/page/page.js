// The live page: listens to the server's events, asks for pictures while it is visible, sends commands.

import { drawCurve } from "./curve.js";
import { colourMap, decode, mapColour, scalePosition, toneMap, valueAt } from "./decode.js";
import { formatCount, formatDuration, formatNumber, formatPercent } from "./text.js";
import { Viewer } from "./viewer.js";

const RETRY_MS = 1000;
const CONFIRM_MS = 4000; // a second click on Stop within this time stops
const REASONS = { error: "the target error is reached", spp: "all samples are taken", time: "the time is over",
  interrupted: "it was stopped", full: "a pixel's sample count is full", failed: "an error ended it" };

const byId = (id) => document.getElementById(id);
const pictures = {}; // the last picture of every layer
let settings = null, status = { state: "connecting" }, rows = [], layer = "image", request = null, hovered = null, isOver = false;

const viewer = new Viewer(byId("picture"), viewChanged, (pixel) => { hovered = pixel; showPixel(); });

// Pictures

// Ask for the next picture of the layer again and again while the page is visible and the render goes on.
async function follow() {
  request?.abort();
  if (document.hidden || !settings) return;
  const own = (request = new AbortController());
  while (!own.signal.aborted) {
    const reduction = viewer.wantedReduction, last = pictures[layer];
    const after = last?.asked === reduction ? last.version : -1;
    try {
      const response = await fetch(`layers/${layer}?after=${after}&reduction=${reduction}`, { signal: own.signal });
      if (response.status === 200) {
        const picture = decode(await response.arrayBuffer());
        if (own.signal.aborted) return;
        pictures[layer] = { ...picture, asked: reduction };
        show();
        continue;
      }
      if (status.state === "ended") return;
      if (response.status === 204) continue;
    } catch {
      if (own.signal.aborted || status.state === "ended") return;
    }
    await new Promise((resolve) => setTimeout(resolve, RETRY_MS));
  }
}

// Take all layers of the finished render with all pixels: the server ends soon.
async function takeAll() {
  isOver = true;
  try {
    for (const name of [layer, "image", "error", "samples"]) {
      const response = await fetch(`layers/${name}`);
      if (response.status !== 200) continue;
      pictures[name] = { ...decode(await response.arrayBuffer()), asked: 1 };
      if (name === layer) show();
    }
  } finally {
    events.close(); // the server waits for it
  }
}

function viewChanged() {
  byId("zoom").textContent = formatPercent(Math.round(viewer.scale * devicePixelRatio * 100) / 100);
  const last = pictures[layer];
  if (last && last.asked !== viewer.wantedReduction && status.state !== "ended") {
    clearTimeout(viewChanged.timer);
    viewChanged.timer = setTimeout(follow, 200);
  }
}

function show() {
  const picture = pictures[layer], isImage = layer === "image";
  byId("exposure-row").hidden = !isImage;
  byId("legend").hidden = isImage || !picture;
  byId("empty").hidden = Boolean(picture);
  byId("empty").textContent = isOver ? "No picture" : "The picture comes soon";
  viewer.hasPicture = Boolean(picture);
  if (!picture) return viewer.draw();
  const rgba = isImage ? toneMap(picture, Number(byId("exposure").value)) : colourMap(picture);
  viewer.show(rgba, picture.width, picture.height, picture.reduction);
  if (!isImage) showLegend(picture);
  showPixel();
}

function showExposure() {
  const stops = Number(byId("exposure").value);
  byId("exposure-value").textContent = `${stops > 0 ? "+" : ""}${stops} EV`;
}

function showLegend(picture) {
  const context = byId("scale").getContext("2d"), width = byId("scale").width;
  for (let x = 0; x < width; x++) {
    context.fillStyle = `rgb(${mapColour(x / (width - 1)).join(" ")})`;
    context.fillRect(x, 0, 1, 1);
  }
  const [low, high] = picture.range, format = layer === "error" ? formatPercent : (value) => formatNumber(value, 4);
  byId("legend-title").textContent = layer === "error" ? "Relative standard error" : "Samples per pixel";
  const marks = [[0, format(low), "first"], [1, format(high), "last"]];
  if (high > 1.5 * low) marks.push([0.5, format(Math.sqrt(low * high)), ""]);
  byId("ticks").replaceChildren(...marks.map(([position, text, name]) => {
    const mark = document.createElement("span");
    mark.textContent = text;
    mark.className = name;
    mark.style.left = `${100 * position}%`;
    return mark;
  }));
}

function showPixel() {
  const picture = pictures[layer];
  if (!hovered || !picture) return void (byId("pixel").textContent = "");
  const [x, y] = hovered.map((position) => Math.floor(position / picture.reduction));
  if (x >= picture.width || y >= picture.height) return void (byId("pixel").textContent = "");
  const values = valueAt(picture, x, y);
  const mean = picture.reduction > 1 ? `, mean of ${picture.reduction}×${picture.reduction}` : "";
  const texts = { image: () => `R ${values.map((value) => formatNumber(value, 4)).join(", ")}`.replace(", ", ", G ")
    .replace(/, ([^,]*)$/, ", B $1"), error: () => `error ${formatPercent(values[0])}`,
    samples: () => `${formatNumber(values[0], 4)} samples` };
  byId("pixel").textContent = `(${hovered.join(", ")})${mean}: ${texts[layer]()}`;
}

// Numbers

function fill(list, entries) {
  list.replaceChildren(...entries.filter(([, text]) => text).flatMap(([label, text]) => {
    const term = document.createElement("dt"), value = document.createElement("dd");
    term.textContent = label;
    value.textContent = text;
    return [term, value];
  }));
}

function showStatus() {
  const { state, elapsed_s, samples, waves, wave_kind, stated_error, remaining_s, reason } = status;
  const badge = byId("state"), isActive = ["rendering", "setting up"].includes(state);
  badge.textContent = state === "ended" ? `ended: ${REASONS[reason] ?? reason}` : state;
  badge.className = `state${isActive ? " active" : ""}${["connection lost", "paused"].includes(state) ? " alert" : ""}`;
  const canCommand = ["rendering", "pausing", "paused"].includes(state);
  byId("pause").textContent = ["pausing", "paused"].includes(state) ? "Resume" : "Pause";
  byId("save").hidden = !settings?.can_save;
  for (const id of ["pause", "save", "stop"]) byId(id).disabled = !canCommand;
  if (samples === undefined) return;
  const pixels = settings ? settings.width * settings.height : 1;
  const quantile = settings ? `p${formatNumber(100 * settings.quantile, 4)}` : "";
  fill(byId("numbers"), [
    ["Time", formatDuration(elapsed_s)],
    ["Time left", state === "ended" ? "" : remaining_s === null ? "unknown" : `about ${formatDuration(remaining_s)}`],
    ["Stated error", stated_error === null ? "" : `${formatPercent(stated_error)} (${quantile})`],
    ["Target error", settings?.error ? formatPercent(settings.error) : ""],
    ["Samples per pixel", formatNumber(samples / pixels, 4) + (settings?.spp ? ` of ${formatNumber(settings.spp, 4)}` : "")],
    ["Samples", `${formatCount(samples)}${elapsed_s > 0 ? `, ${formatCount(samples / elapsed_s)}/s` : ""}`],
    ["Waves", formatNumber(waves, 6) + (wave_kind ? `, now ${wave_kind}` : "")],
  ]);
}

function showSettings() {
  byId("title").textContent = document.title = settings.title;
  viewer.setSize(settings.width, settings.height);
  fill(byId("settings"), [["Size", `${settings.width}×${settings.height}`], ["Strategy", settings.strategy.replaceAll(",", ",\u200b")],
    ["Device", settings.device], ["Time limit", settings.time_s ? formatDuration(settings.time_s) : ""]]);
}

let messageTimer = 0;
function showMessage(text) {
  byId("message").textContent = text;
  byId("message").hidden = false;
  clearTimeout(messageTimer);
  messageTimer = setTimeout(() => { byId("message").hidden = true; }, 8000);
}

// The server

const events = new EventSource("events");
events.addEventListener("open", () => { rows = []; });
events.addEventListener("settings", (event) => {
  if (!settings) byId("exposure").value = JSON.parse(event.data).stops;
  settings = JSON.parse(event.data);
  showExposure();
  showSettings();
  follow();
});
events.addEventListener("rows", (event) => {
  rows.push(...JSON.parse(event.data));
  drawCurve(byId("curve"), byId("curve-key"), rows, settings?.error);
});
events.addEventListener("message", (event) => showMessage(JSON.parse(event.data)));
events.addEventListener("status", (event) => {
  status = JSON.parse(event.data);
  showStatus();
  if (status.state === "ended" && !isOver) {
    request?.abort();
    takeAll();
  }
});
events.addEventListener("error", () => {
  if (status.state === "ended") return;
  status = { ...status, state: "connection lost" };
  showStatus();
});

async function command(name) {
  try {
    const response = await fetch(name, { method: "POST" });
    if (!response.ok) showMessage(`The server refused: ${await response.text()}`);
  } catch {
    showMessage("The render does not answer.");
  }
}

// Controls

byId("pause").addEventListener("click", () => command(byId("pause").textContent === "Pause" ? "pause" : "resume"));
byId("save").addEventListener("click", () => command("save"));
let stopTimer = 0;
byId("stop").addEventListener("click", () => {
  const button = byId("stop");
  clearTimeout(stopTimer);
  if (button.dataset.asked) {
    delete button.dataset.asked;
    button.textContent = "Stop";
    return command("stop");
  }
  button.dataset.asked = "yes";
  button.textContent = "Stop: sure?";
  stopTimer = setTimeout(() => {
    delete button.dataset.asked;
    button.textContent = "Stop";
  }, CONFIRM_MS);
});
const tabs = [...document.querySelectorAll("[data-layer]")];
function selectLayer(tab) {
  layer = tab.dataset.layer;
  for (const each of tabs) {
    each.setAttribute("aria-selected", String(each === tab));
    each.tabIndex = each === tab ? 0 : -1;
  }
  show();
  if (status.state !== "ended") follow();
}
for (const [index, tab] of tabs.entries()) {
  tab.addEventListener("click", () => selectLayer(tab));
  tab.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    const next = tabs[(index + step + tabs.length) % tabs.length];
    next.focus();
    selectLayer(next);
  });
}
byId("zoom-in").addEventListener("click", () => viewer.zoomTo(viewer.scale * 1.25));
byId("zoom-out").addEventListener("click", () => viewer.zoomTo(viewer.scale / 1.25));
byId("fit").addEventListener("click", () => viewer.fit());
byId("actual").addEventListener("click", () => viewer.zoomTo(1 / devicePixelRatio));
byId("exposure").addEventListener("input", () => {
  showExposure();
  show();
});
document.addEventListener("visibilitychange", follow);

// Pictures of the server: float16 values to colours, by tables with an entry per float16 number.

const SHOULDER = 0.6; // as isonoise.film.png

// A picture of GET layers/NAME: facts (JSON) and the float16 numbers of its channels.
export function decode(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const facts = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  return { ...facts, values: new Uint16Array(buffer, 4 + length) };
}

const NUMBERS = new Float32Array(65536); // of the float16 with these bits
for (let bits = 0; bits < 65536; bits++) {
  const exponent = (bits >> 10) & 31, fraction = bits & 1023;
  const size = exponent === 31 ? (fraction ? NaN : Infinity)
    : exponent ? 2 ** (exponent - 25) * (1024 + fraction) : 2 ** -24 * fraction;
  NUMBERS[bits] = bits >> 15 ? -size : size;
}

// The value at pixel (x, y) of a picture, one number per channel.
export function valueAt(picture, x, y) {
  const pixels = picture.width * picture.height, first = y * picture.width + x;
  return Array.from({ length: picture.channels }, (_, channel) =>
    NUMBERS[picture.values[channel * pixels + first]] * picture.unit);
}

function displayValue(value) { // the curve and the sRGB encoding of PNG files
  if (!(value > 0)) return 0;
  if (value > SHOULDER) value = SHOULDER + (1 - SHOULDER) * -Math.expm1(-(value - SHOULDER) / (1 - SHOULDER));
  return Math.round(255 * (value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055));
}

// The image as RGBA; exposure in stops, 0 is that of PNG files.
export function toneMap(picture, stops) {
  const factor = picture.unit * picture.exposure * 2 ** stops;
  const table = new Uint8Array(65536);
  for (let bits = 0; bits < 65536; bits++) table[bits] = displayValue(Math.min(NUMBERS[bits], 65504) * factor);
  const pixels = picture.width * picture.height, values = picture.values;
  const result = new Uint32Array(pixels);
  for (let i = 0, j = pixels, k = 2 * pixels; i < pixels; i++, j++, k++)
    result[i] = 0xff000000 | (table[values[k]] << 16) | (table[values[j]] << 8) | table[values[i]];
  return result;
}

const VIRIDIS = [[68, 1, 84], [72, 40, 120], [62, 74, 137], [49, 104, 142], [38, 130, 142], [31, 158, 137],
  [53, 183, 121], [110, 206, 88], [181, 222, 43], [253, 231, 37]];
const UNKNOWN = [128, 128, 128];

// Colour of a position from 0 to 1 on the scale of a map.
export function mapColour(position) {
  if (!Number.isFinite(position)) return UNKNOWN;
  const place = Math.min(Math.max(position, 0), 1) * (VIRIDIS.length - 1);
  const index = Math.min(Math.floor(place), VIRIDIS.length - 2), part = place - index;
  return VIRIDIS[index].map((low, channel) => Math.round(low + part * (VIRIDIS[index + 1][channel] - low)));
}

// Position of a value on the logarithmic scale of a picture.
export function scalePosition(picture, value) {
  const [low, high] = picture.range;
  if (!Number.isFinite(value)) return NaN;
  if (value <= low || high <= low) return value > high ? 1 : 0;
  return Math.log(value / low) / Math.log(high / low);
}

// A map as RGBA.
export function colourMap(picture) {
  const table = new Uint32Array(65536);
  for (let bits = 0; bits < 65536; bits++) {
    const [red, green, blue] = mapColour(scalePosition(picture, NUMBERS[bits] * picture.unit));
    table[bits] = 0xff000000 | (blue << 16) | (green << 8) | red;
  }
  return Uint32Array.from(picture.values, (bits) => table[bits]);
}

// Numbers and durations as text, as isonoise prints them.

export function formatNumber(value, digits = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "unknown";
  if (value !== 0 && (Math.abs(value) < 1e-9 || Math.abs(value) >= 1e12)) return value.toPrecision(digits);
  return value.toLocaleString("en", { maximumSignificantDigits: digits });
}

export function formatPercent(value) {
  return value === null || value === undefined || !Number.isFinite(value) ? "unknown" : `${formatNumber(100 * value)} %`;
}

export function formatCount(value) {
  for (const [unit, size] of [["T", 1e12], ["G", 1e9], ["M", 1e6], ["k", 1e3]])
    if (value >= 0.9995 * size) return `${formatNumber(value / size)} ${unit}`;
  return formatNumber(value);
}

export function formatDuration(seconds) {
  if (seconds < 9.995) return `${seconds.toFixed(2)} s`;
  if (seconds < 59.95) return `${seconds.toFixed(1)} s`;
  const whole = Math.round(seconds), two = (number) => String(number).padStart(2, "0");
  const hours = Math.floor(whole / 3600), minutes = Math.floor(whole / 60) % 60;
  return hours ? `${hours}:${two(minutes)}:${two(whole % 60)}` : `${minutes}:${two(whole % 60)}`;
}

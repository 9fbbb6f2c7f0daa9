// Words for figures. Times are milliseconds since 1970 (UTC) and are shown in the reader's own zone, in 24 hours: here
// and nowhere else. The command line shows them by moments.py.

/** A moment: date, time to the second, and the offset from UTC, as in “22 Nov 2026, 14:03:05 UTC+01:00”. */
export function formatTime(ms, locale) {
  return `${new Intl.DateTimeFormat(locale, { dateStyle: "medium", timeStyle: "medium", hourCycle: "h23" }).format(new Date(ms))} ${zoneOffset(ms)}`;
}

/** The time of day alone, on a page that names the zone. */
export function formatClock(ms, locale) {
  return new Intl.DateTimeFormat(locale, { timeStyle: "medium", hourCycle: "h23" }).format(new Date(ms));
}

/** The offset of the reader's zone from UTC at a moment: “UTC” or “UTC+01:00”. */
export function zoneOffset(ms) {
  const minutes = -new Date(ms).getTimezoneOffset();
  const two = (value) => String(value).padStart(2, "0");
  return minutes === 0 ? "UTC" : `UTC${minutes < 0 ? "-" : "+"}${two(Math.floor(Math.abs(minutes) / 60))}:${two(Math.abs(minutes) % 60)}`;
}

/** The reader's time zone, such as Europe/Berlin. */
export function zoneName() {
  return new Intl.DateTimeFormat().resolvedOptions().timeZone;
}

/** A day, with its weekday. */
export function formatDay(ms, locale) {
  return new Intl.DateTimeFormat(locale, { weekday: "long", day: "numeric", month: "long", year: "numeric" }).format(new Date(ms));
}

/** A length of time, in the largest two units that say something. */
export function formatDuration(ms) {
  if (ms < 1000) return `${Math.round(ms)} ms`;
  const seconds = ms / 1000;
  if (seconds < 60) return `${seconds.toFixed(seconds < 10 ? 1 : 0)} s`;
  const minutes = Math.floor(seconds / 60);
  if (minutes < 60) return `${minutes} min ${Math.floor(seconds % 60)} s`;
  const hours = Math.floor(minutes / 60);
  return hours < 48 ? `${hours} h ${minutes % 60} min` : `${Math.floor(hours / 24)} d ${hours % 24} h`;
}

/** A size, in decimal units. */
export function formatBytes(n) {
  if (n < 1000) return `${n} B`;
  const units = ["kB", "MB", "GB", "TB"];
  let value = n;
  let unit = -1;
  while (value >= 1000 && unit < units.length - 1) {
    value /= 1000;
    unit += 1;
  }
  return `${value.toFixed(value < 10 ? 1 : 0)} ${units[unit]}`;
}

/** A number with the reader's separators. */
export function formatNumber(n, locale) {
  return new Intl.NumberFormat(locale).format(n);
}

/** The beginning and the end of a long hexadecimal name. */
export function shortHex(hex) {
  return hex.length > 16 ? `${hex.slice(0, 8)}…${hex.slice(-6)}` : hex;
}

/** One of two forms, with the number before it. */
export function plural(n, one, many) {
  return `${formatNumber(n)} ${n === 1 ? one : many}`;
}

// How values are written. What is not known is a question mark, never a number.

export const UNKNOWN = "?";

export function number(value, digits = 1) {
  return value === null || value === undefined ? UNKNOWN : value.toFixed(digits);
}

export function count(value) {
  return value === null || value === undefined ? UNKNOWN : String(value);
}

export function age(seconds) {
  if (seconds === null || seconds === undefined) return "never";
  return seconds < 1 ? `${Math.round(seconds * 1000)} ms` : `${seconds.toFixed(1)} s`;
}

export function micros(us) {
  if (us === null || us === undefined) return UNKNOWN;
  if (us < 1000) return `${us} µs`;
  return us < 1e6 ? `${trim(us / 1e3)} ms` : `${trim(us / 1e6)} s`;
}

function trim(value) {
  return value < 10 ? String(Math.round(value * 10) / 10) : String(Math.round(value));
}

const GOOD = new Set(["Adhering", "NoFault", "NotDetected", "Tracking", "Running", "Operation",
  "Operational", "active"]);
const BAD = new Set(["AdhesionLost", "Fault", "AllDrives", "Diverged", "Silent", "bus-off",
  "absent", "down", "passive"]);
const UNKNOWNS = new Set(["Unknown", UNKNOWN]);

// good, bad, warn or unknown: of a flag or state by its name in the DBC.
export function kind(word) {
  if (GOOD.has(word)) return "good";
  if (BAD.has(word)) return "bad";
  return UNKNOWNS.has(word) ? "unknown" : "warn";
}

export const SIGNS = { good: "✓", bad: "✗", warn: "!", unknown: "?" };

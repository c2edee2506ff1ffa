// Numbers with the prefix of their unit: 0.00124 m is 1.24 mm.

const PREFIXES = { "-12": "p", "-9": "n", "-6": "µ", "-3": "m", 0: "", 3: "k", 6: "M", 9: "G" };
const SUPERSCRIPTS = { "-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹" };
const TAKES_PREFIX = /^(m|N|J|W|rad|s|V|A|Hz|Pa)(?![\w^²³])/;

/** Exponent of ten, a multiple of 3, for a value. */
export function exponentOf(value) {
  const size = Math.abs(value);
  if (!(size > 0) || !Number.isFinite(size)) return 0;
  return 3 * Math.floor((Math.log10(size) + 1e-9) / 3);
}

/** Unit with the prefix of 10^exponent; for units without prefixes the power is written. */
export function prefixed(unit, exponent) {
  if (!exponent) return unit;
  if (TAKES_PREFIX.test(unit) && exponent in PREFIXES) return PREFIXES[exponent] + unit;
  const power = "10" + [...String(exponent)].map((c) => SUPERSCRIPTS[c]).join("");
  return unit && unit !== "1" ? `${power} ${unit}` : power;
}

/** @param {number} value @param {string} unit */
export function quantity(value, unit) {
  if (!Number.isFinite(value)) return "no value";
  let exponent = exponentOf(value);
  if (exponent < -12 || value === 0) return `0 ${unit}`.trim();
  if (exponent === -3 && !TAKES_PREFIX.test(unit)) exponent = 0;
  return `${(value / 10 ** exponent).toPrecision(3)} ${prefixed(unit, exponent)}`.trim();
}

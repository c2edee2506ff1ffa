// Decoding of a SERIES: offset + scale * integer; the integers are raw DEFLATE of zigzag varint deltas.

/** @typedef {{n: number, scale: number, offset: number, data: string, nan?: number[][]}} Series */

/** @type {Map<string, Promise<Float64Array>>} Series that occur several times (times of plots) are decoded once. */
const decoded = new Map();

/** @param {string} text @returns {Uint8Array} */
function fromBase64(text) {
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; i++) bytes[i] = binary.charCodeAt(i);
  return bytes;
}

/** @param {Uint8Array} bytes @returns {Promise<Uint8Array>} */
async function inflate(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** @param {Series} series @returns {Promise<Float64Array>} */
async function unpack(series) {
  const values = new Float64Array(series.n).fill(series.offset);
  if (series.data) {
    const bytes = await inflate(fromBase64(series.data));
    const { n, scale, offset } = series;
    let at = 0;
    let sum = 0;
    for (let i = 0; i < n; i++) {
      if (at >= bytes.length) {
        values.fill(NaN, i); // the data are cut short
        break;
      }
      // Multiplication, not shifts: an integer may have 53 bits.
      let zigzag = 0;
      let weight = 1;
      let byte;
      do {
        byte = bytes[at++];
        zigzag += (byte & 127) * weight;
        weight *= 128;
      } while (byte > 127);
      sum += zigzag % 2 ? -(zigzag + 1) / 2 : zigzag / 2;
      values[i] = offset + scale * sum;
    }
  }
  for (const [from, to] of series.nan ?? []) values.fill(NaN, from, to);
  return values;
}

/** Decode a series. The result is shared: do not change it. @param {Series | null | undefined} series */
export function decode(series) {
  if (!series || !(series.n > 0)) return Promise.resolve(new Float64Array(0));
  const key = JSON.stringify([series.n, series.scale, series.offset, series.nan, series.data]);
  let result = decoded.get(key);
  if (!result) decoded.set(key, (result = unpack(series)));
  return result;
}

/** @param {(Series | null)[] | null | undefined} list */
export function decodeAll(list) {
  return Promise.all((list ?? []).map(decode));
}

/** Decode times: each at least its predecessor, as the search in them expects. @param {Series | null} series */
export async function decodeTimes(series) {
  const times = await decode(series);
  let last = -Infinity;
  if (times.every((t) => t >= last && ((last = t), true))) return times;
  const sorted = Float64Array.from(times);
  last = sorted.find((t) => t === t) ?? 0;
  for (let i = 0; i < sorted.length; i++) sorted[i] = last = sorted[i] >= last ? sorted[i] : last;
  return sorted;
}

/** Index of the last time that is not after `t`, up to a rounding; 0 before the first, -1 without times. @param {Float64Array} times @param {number} t */
export function indexAt(times, t) {
  // Times are multiples of the scale: the time of a sample in another form may be a rounding before it.
  const limit = t + 1e-9 * Math.max(1, Math.abs(t));
  let low = 0;
  let high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= limit) low = middle + 1;
    else high = middle;
  }
  return Math.max(low - 1, Math.min(0, times.length - 1));
}

/** Bytes of a base64 text as an array of 4-byte elements. @param {string} text */
export function bytesOf(text) {
  return fromBase64(text).buffer;
}

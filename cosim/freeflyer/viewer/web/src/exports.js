// Files and links that the page makes: a picture, a CSV file, a link with time and camera.

import { css, short } from "./dom.js";
import { load } from "./plots.js";

/** Offer a file for download. @param {string} name @param {Blob} blob */
function download(name, blob) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

/** A name without the characters that file systems reserve. */
function fileName(title, ending) {
  return (short(title, 60).replace(/[^\p{L}\p{N}._-]+/gu, "_").replace(/^[._]+/, "") || "run") + ending;
}

/** Text of one cell. Spreadsheets execute cells that begin with = + - @: those get an apostrophe. */
function cell(text) {
  const safe = /^[=+\-@\t\r]/.test(text) ? `'${text}` : text;
  return /[",\n\r]/.test(safe) ? `"${safe.replaceAll('"', '""')}"` : safe;
}

/** CSV of all signals between two times, one value a row. */
export async function csv(runs, joined, [from, to]) {
  const rows = ["run,plot,signal,unit,time [s],value\n"];
  for (const plot of joined)
    for (const signal of plot.signals) {
      await load(signal);
      const head = [runs[signal.run].label, plot.title, signal.label, plot.unit].map(cell).join(",");
      const part = [];
      for (let i = 0; i < signal.times.length; i++) {
        const t = signal.times[i];
        if (t < from || t > to) continue;
        const value = signal.values[i];
        part.push(`${head},${Number(t.toPrecision(12))},${value === value ? Number(value.toPrecision(12)) : ""}\n`);
      }
      rows.push(part.join(""));
    }
  return rows.join("");
}

export async function saveCsv(title, runs, joined, window) {
  download(fileName(title, ".csv"), new Blob([await csv(runs, joined, window)], { type: "text/csv" }));
}

/** Picture of the panels with their captions and the plots that are in view. */
export function picture(stage, panels, captions, footer, charts, time) {
  const ratio = stage ? stage.ratio : Math.min(2, window.devicePixelRatio || 1);
  const outer = stage ? stage.element.getBoundingClientRect() : { width: 900, height: 0, left: 0, top: 0 };
  const columns = charts.length > 1 ? 2 : 1;
  const wide = outer.width / columns;
  const chartHeight = 196;
  const rows = Math.ceil(charts.length / columns);
  const canvas = document.createElement("canvas");
  canvas.width = Math.round(outer.width * ratio);
  canvas.height = Math.round((outer.height + 34 + rows * chartHeight) * ratio);
  const c = canvas.getContext("2d");
  c.fillStyle = css("--panel");
  c.fillRect(0, 0, canvas.width, canvas.height);
  if (stage) c.drawImage(stage.canvas, 0, 0);
  c.scale(ratio, ratio);
  c.textBaseline = "top";
  panels.forEach((panel, k) => {
    const box = panel.getBoundingClientRect();
    const x = box.left - outer.left;
    const y = box.top - outer.top;
    captions[k].lines.forEach((line, row) => {
      c.font = row ? "13px system-ui, sans-serif" : "600 16px system-ui, sans-serif";
      c.fillStyle = css("--text");
      c.fillText(short(line, 110), x + 14, y + 12 + row * 21, box.width - 28);
    });
  });
  c.fillStyle = css("--text");
  c.font = "13px system-ui, sans-serif";
  c.fillText(footer, 14, outer.height + 10, outer.width - 28);
  charts.forEach(({ title, unitShown, signals, chart }, k) => {
    const x = (k % columns) * wide + 14;
    const y = outer.height + 34 + Math.floor(k / columns) * chartHeight;
    c.font = "600 13px system-ui, sans-serif";
    c.fillStyle = css("--text");
    c.fillText(short(`${title} [${unitShown.textContent}]`, 80), x, y, wide - 28);
    c.font = "11px system-ui, sans-serif";
    let right = x;
    for (const signal of signals) {
      const label = short(panels.length > 1 ? `${signal.label}, ${captions[signal.run].lines[0]}` : signal.label, 40);
      const needed = c.measureText(label).width + 32;
      if (right + needed > x + wide - 28) break;
      c.fillStyle = signal.color;
      c.fillRect(right, y + 24, 14, 4);
      c.fillStyle = css("--text");
      c.fillText(label, right + 18, y + 20);
      right += needed;
    }
    const source = chart.ctx.canvas;
    const scale = Math.min((wide - 16) / source.width, (chartHeight - 42) / source.height);
    c.drawImage(source, x - 6, y + 36, source.width * scale, source.height * scale);
    const { min, max } = chart.scales.x;
    const { left, top, width, height } = chart.bbox;
    if (time >= min && time <= max)
      c.fillRect(x - 7 + (left + ((time - min) / (max - min)) * width) * scale, y + 36 + top * scale, 2, height * scale);
  });
  return canvas;
}

export function savePicture(title, canvas) {
  canvas.toBlob((blob) => blob && download(fileName(title, ".png"), blob), "image/png");
}

const number = (value) => String(Number(value.toPrecision(7)));

/** Text after # with time, camera and options. */
export function toHash(time, view, options) {
  const parts = [`t=${number(time)}`];
  if (view) parts.push(`camera=${view.map(number).join(",")}`);
  parts.push(`deviation=${options.deviation}`, `follow=${options.follow}`);
  return "#" + parts.join("&");
}

/** What a link says; parts that are not valid are left out. */
export function fromHash(hash) {
  const result = {};
  const parts = new URLSearchParams(hash.replace(/^#/, ""));
  const time = Number(parts.get("t") ?? NaN);
  if (Number.isFinite(time)) result.time = time;
  const view = (parts.get("camera") ?? "").split(",").map(Number);
  if (view.length === 6 && view.every((v) => Number.isFinite(v) && Math.abs(v) < 1e6)) result.view = view;
  for (const key of ["deviation", "follow"]) if (parts.has(key)) result[key] = parts.get(key);
  return result;
}

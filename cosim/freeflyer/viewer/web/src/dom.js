// Elements are made by these functions; text is always set as text, never parsed as HTML.

const SVG = "http://www.w3.org/2000/svg";

/** Make an element. Keys: on... are listeners, `class`, `text`, others are attributes; false and null are left out. */
export function h(tag, keys = {}, ...children) {
  const element = document.createElement(tag);
  for (const [key, value] of Object.entries(keys)) {
    if (value === false || value === null || value === undefined) continue;
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (key === "text") element.textContent = value;
    else if (key === "class") element.className = value;
    else element.setAttribute(key, value === true ? "" : String(value));
  }
  element.append(...children.filter((child) => child !== null && child !== undefined && child !== false));
  return element;
}

const ICONS = {
  play: "M7 4l13 8-13 8z",
  pause: "M6 4h4v16H6zM14 4h4v16h-4z",
  start: "M5 4h3v16H5zM20 4v16L9 12z",
  end: "M16 4h3v16h-3zM4 4v16l11-8z",
  back: "M14 4v16L5 12zM16 4h3v16h-3z",
  forward: "M10 4v16l9-8zM5 4h3v16H5z",
};

/** @param {keyof ICONS} name */
export function icon(name) {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", "0 0 24 24");
  svg.setAttribute("aria-hidden", "true");
  const path = document.createElementNS(SVG, "path");
  path.setAttribute("d", ICONS[name]);
  svg.append(path);
  return svg;
}

export function setIcon(button, name) {
  button.querySelector("svg").replaceWith(icon(name));
}

/** Value of a CSS variable of the theme. */
export function css(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

/** A long text in one line of at most `most` characters. */
export function short(text, most = 120) {
  const line = String(text).replace(/\s+/g, " ");
  return line.length > most ? line.slice(0, most - 1) + "…" : line;
}

// The palette of Okabe and Ito, which colour-blind readers can distinguish.

export const OKABE = {
  black: "#000000",
  orange: "#E69F00",
  sky: "#56B4E9",
  green: "#009E73",
  yellow: "#F0E442",
  blue: "#0072B2",
  vermillion: "#D55E00",
  purple: "#CC79A7",
};

/** Meaning of the colours in the picture and on the time axis. */
export const MEANING = {
  wanted: OKABE.green,
  base: OKABE.orange,
  end_effector: OKABE.sky,
  passivity: OKABE.purple,
  fault: OKABE.vermillion,
  axes: [OKABE.vermillion, OKABE.green, OKABE.blue],
};

/** Lines of the plots: of the first run cold colours, of the second warm ones. */
export const LINES = [
  [OKABE.blue, OKABE.sky, OKABE.green],
  [OKABE.vermillion, OKABE.orange, OKABE.purple],
];

/** Lines of a single run: all colours. */
export const LINES_OF_ONE = [OKABE.blue, OKABE.vermillion, OKABE.green, OKABE.orange, OKABE.purple, OKABE.sky];

/** A colour for CSS: blue has too little contrast on a dark ground. */
export const themed = (color) => (color === OKABE.blue ? "var(--blue)" : color);

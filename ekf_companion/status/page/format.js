/** Numbers as text, and text into the page. */

export const $ = (id) => document.getElementById(id);

export const isKnown = (value) => typeof value === "number" && Number.isFinite(value);

/** A number with so many digits behind the point; a dash where it is not known. */
export const fixed = (value, digits, unit = "") =>
  isKnown(value) ? value.toFixed(digits).replace(/^-(0\.?0*)$/, "$1") + unit : "\u2013";

/** Difference of two angles, degrees, in [-180, 180). */
export const turn = (a, b) => ((((a - b + 180) % 360) + 360) % 360) - 180;

/** Put text into an element, only if it is another. */
export function put(id, text, kind = "") {
  const element = typeof id === "string" ? $(id) : id;
  if (element.textContent !== text) element.textContent = text;
  if (element.className !== kind && !element.classList.contains("badge")) element.className = kind;
}

/** An element with text and children. */
export function make(tag, text = "", kind = "", children = []) {
  const element = document.createElement(tag);
  if (text) element.textContent = text;
  if (kind) element.className = kind;
  element.append(...children);
  return element;
}

/** Colours of the present scheme, by the names of the style sheet. */
export function colours() {
  const style = getComputedStyle(document.documentElement);
  return new Proxy({}, { get: (_, name) => style.getPropertyValue(`--${name}`).trim() });
}

/** A canvas at the resolution of the screen: its context, width and height in CSS pixels. */
export function open(canvas) {
  const { clientWidth: width, clientHeight: height } = canvas;
  const ratio = window.devicePixelRatio || 1;
  const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}

// Elements and texts. Every text goes in as a text node: nothing that a run writes is ever markup.

const SVG = "http://www.w3.org/2000/svg";
const SVG_TAGS = new Set(["svg", "path", "circle", "g", "line", "rect", "text", "title", "polyline"]);

export function h(tag, attributes = {}, ...children) {
  const element = SVG_TAGS.has(tag) ? document.createElementNS(SVG, tag) : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes ?? {})) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return element;
}

// Sets a text only if it is another one, so that nothing flickers and no selection is lost.
export function say(element, text) {
  text = String(text ?? "");
  if (element.textContent !== text) element.textContent = text;
}

export function show(element, visible) {
  element.classList.toggle("hidden", !visible);
}

// A choice of one among several: radio buttons that look like a switch.
let groups = 0;
export function choice(legend, options, chosen, onchange) {
  const name = `choice-${groups++}`;
  return h("fieldset", { class: "seg" }, h("legend", {}, legend), options.map(([value, label]) =>
    h("label", {}, h("input", {
      type: "radio", name, value, checked: value === chosen, onchange: () => onchange(value),
    }), label)));
}

export function check(label, checked, onchange) {
  const box = h("input", { type: "checkbox", checked });
  box.addEventListener("change", () => onchange(box.checked));
  return h("label", { class: "check" }, box, label);
}

const whole = new Intl.NumberFormat("en", { maximumFractionDigits: 0 });
// Numbers that no run comes to are not written out.
const HUGE = 1e15;
export const count = (x) => (!Number.isFinite(x) ? "–" : Math.abs(x) < HUGE ? whole.format(x) : x.toExponential(1));
export const percent = (x) => (Number.isFinite(x) ? `${(100 * x).toFixed(x > 0 && x < 0.1 ? 1 : 0)} %` : "–");
export function number(x) {
  if (!Number.isFinite(x)) return "–";
  const size = Math.abs(x);
  if (size >= 1000) return count(x);
  if (size !== 0 && size < 0.001) return x.toExponential(1);
  return String(Number(size < 1 ? x.toPrecision(3) : x.toFixed(size >= 100 ? 1 : 3)));
}
export function duration(s) {
  if (!Number.isFinite(s)) return "–";
  if (s < 10) return `${s.toFixed(1)} s`;
  const [hours, minutes, seconds] = [Math.floor(s / 3600), Math.floor(s / 60) % 60, Math.floor(s) % 60];
  if (hours >= 48) return `${count(hours / 24)} days`;
  if (hours) return `${hours} h ${minutes} min`;
  return minutes ? `${minutes} min ${seconds} s` : `${seconds} s`;
}
export function moment(seconds) {
  const date = new Date(seconds * 1000);
  return Number.isNaN(date.getTime()) ? "" : date.toLocaleString("en-GB", { hour12: false });
}

export const color = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

const WORDS = {
  running: ["●", "Running"], starting: ["○", "Starting"], finished: ["✓", "Finished"],
  failed: ["✕", "Failed"], interrupted: ["❚❚", "Interrupted"], nothing: ["○", "Nothing yet"],
};
export function pill(state, text) {
  const [sign, word] = WORDS[state] ?? ["✓", state];
  return h("span", { class: `pill ${state}` }, h("span", { "aria-hidden": "true" }, sign), text ?? word);
}

export function address(kind, below) {
  const names = below.split("/").filter(Boolean).map(encodeURIComponent).join("/");
  return names ? `/${kind}/${names}` : `/${kind}`;
}
